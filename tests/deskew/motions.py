"""Motions for the deskew and codec tests."""

from __future__ import annotations

import numpy as np

from splitslam import se3
from splitslam.features import Knots

FAST_TURN_RADPS = np.radians(217.0)
HEAD_TURN_RADPS = np.radians(131.0)


def turning(offsets_ns: np.ndarray, peak_radps: float, period_s: float = 1.0, phase: float = 0.3) -> Knots:
    """A head turned to and fro (yaw rate a sine of `period_s`) while it nods, rolls and walks."""
    t = offsets_ns * 1e-9
    w = 2 * np.pi / period_s
    yaw = peak_radps / w * (np.cos(phase) - np.cos(w * t + phase))
    R = [se3.so3_exp(np.array([0.05 * np.sin(9 * s), 0.2 * s, a])) for s, a in zip(t, yaw, strict=True)]
    rotation = np.array([se3.so3_log(R[0].T @ r) for r in R])
    translation = np.stack([1.4 * t, 0.05 * np.sin(12 * t), 0.02 * (np.cos(12 * t) - 1)], axis=1)
    return Knots(offsets_ns.astype(np.int64), rotation, translation)


def imu_offsets(rate_hz: float, end_ns: int = 100_000_000, first_ns: int = 700_000) -> np.ndarray:
    """Knot times as the Imu node has them: scan start, IMU samples off the grid, scan end."""
    return np.unique(np.concatenate([[0], np.arange(first_ns, end_ns, round(1e9 / rate_hz)), [end_ns]])).astype(
        np.int64
    )


def far_points(count: int, range_m: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) float32 points at one range in all directions, and times (N,) int32 over 0.1 s, unsorted."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(count, 3))
    points = range_m * d / np.linalg.norm(d, axis=1, keepdims=True)
    return points.astype(np.float32), rng.integers(0, 100_000_000, count).astype(np.int32)
