"""Scans and motions that the figures are measured on."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge_agent.sources import open_recording
from splitslam import se3
from splitslam.errors import InputError
from splitslam.features import Knots
from splitslam.robot import load_robot
from splitslam.scan import Scan

SCAN_NS = 100_000_000
FAST_TURN_RADPS = np.radians(217.4)  # the paper's Table I: the fastest of its data sets
ROOT = Path(__file__).resolve().parents[2]


def turning(imu_hz: float = 500.0, phase: float = 0.3, peak_radps: float = FAST_TURN_RADPS) -> Knots:
    """A head turned to and fro in a second, nodding and rolling as it walks; knots at IMU samples, off the grid."""
    inside = np.arange(700_000, SCAN_NS, round(1e9 / imu_hz))
    offsets_ns = np.concatenate([[0], inside, [SCAN_NS]]).astype(np.int64)
    t = offsets_ns * 1e-9
    yaw = peak_radps / (2 * np.pi) * (np.cos(phase) - np.cos(2 * np.pi * t + phase))
    turned = [se3.so3_exp(np.array([0.05 * np.sin(9 * s), 0.2 * s, a])) for s, a in zip(t, yaw, strict=True)]
    rotation = np.array([se3.so3_log(turned[0].T @ R) for R in turned])
    translation = np.stack([1.4 * t, 0.05 * np.sin(12 * t), 0.02 * (np.cos(12 * t) - 1)], axis=1)
    return Knots(offsets_ns, rotation, translation)


def full_scan(rings: int, columns: int) -> Scan:
    """A point in every cell, firing by firing, in a room with pillars: what costs the cores most."""
    column, ring = np.divmod(np.arange(rings * columns), rings)
    azimuth = 2 * np.pi * (columns / 2 - column) / columns
    elevation = np.radians(30.0) * (ring / max(rings - 1, 1) - 0.5)
    wall = 6.0 / np.maximum(np.abs(np.cos(azimuth)), np.abs(np.sin(azimuth)))
    distance = np.where(np.cos(24 * azimuth) > 0.9, 0.6, 1.0) * wall + 0.3 * elevation
    points = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=1) * distance[:, None]
    return _scan(points.astype(np.float32), ring, (column * (SCAN_NS // columns)).astype(np.int32))


def far_points(count: int, range_m: float, seed: int = 0) -> Scan:
    """Points at one range in all directions, at any time of the scan, on ring 0."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(count, 3))
    points = (range_m * d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    return _scan(points, np.zeros(count, np.int64), rng.integers(0, SCAN_NS, count).astype(np.int32))


def random_image(rings: int, columns: int, seed: int) -> Scan:
    """Pieces of surfaces with gaps, steps, noise and points out of order, twice, not finite or on no ring."""
    rng = np.random.default_rng(seed)
    column, ring = np.divmod(np.arange(rings * columns), rings)
    kept = np.flatnonzero(rng.random(len(ring)) < rng.uniform(0.2, 1.0, rings)[ring])
    kept = np.concatenate([kept, rng.choice(kept, len(kept) // 20)])
    swapped = rng.random(len(kept)) < 0.05
    kept[swapped] = rng.permutation(kept[swapped])
    column, ring = column[kept], ring[kept]
    steps = np.cumsum(rng.random((rings, columns)) < 0.03, axis=1)
    distance = rng.uniform(0.5, 250.0, steps.max() + 1)[steps][ring, column] * rng.normal(1.0, 0.004, len(ring))
    azimuth = 2 * np.pi * (columns / 2 - column + rng.uniform(-0.4, 0.4, len(ring))) / columns
    points = np.stack([np.cos(azimuth), np.sin(azimuth), rng.uniform(-0.2, 0.2, len(ring))], axis=1)
    points = (points * distance[:, None]).astype(np.float32)
    points[rng.random(len(points)) < 0.005] = np.nan
    points[rng.random(len(points)) < 0.005, 1] = np.inf
    ring = np.where(rng.random(len(ring)) < 0.01, rings, ring)
    return _scan(points, ring, (column * (SCAN_NS // columns)).astype(np.int32))


def yard1(count: int) -> list[Scan]:
    """The first scans of the recording `yard1` in $SPLITSLAM_DATA or ../shared/data. InputError if it is not there."""
    folder = Path(os.environ.get("SPLITSLAM_DATA") or ROOT.parent / "shared" / "data") / "yard1"
    with open_recording(folder / "yard1.bag", load_robot(folder / "yard1.yaml"), max_scans=count) as recording:
        scans = [event for _, event in recording.events() if isinstance(event, Scan)]
    if len(scans) != count:
        raise InputError(f"{folder}: {len(scans)} scans, expected {count}")
    return scans


def _scan(points: NDArray[np.float32], ring: NDArray[np.int64], t_offset_ns: NDArray[np.int32]) -> Scan:
    return Scan(0, SCAN_NS, points, t_offset_ns, ring.astype(np.uint8), np.zeros(len(points), np.uint8))
