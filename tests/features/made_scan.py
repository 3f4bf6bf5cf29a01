"""A small made room for the edge's tests, and an Imu node that knows the motion."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from edge_agent.pipeline import EdgePipeline
from edge_agent.settings import PipelineSettings
from splitslam import se3
from splitslam.features import Knots, Motion
from splitslam.robot import Robot
from splitslam.scan import Scan

ELEVATIONS_RAD = np.radians(np.arange(-15, 16, 2)).astype(np.float32)
START_NS = 1_700_000_000_000_000_000


def made_scan(seed: int = 0, elevations_rad: np.ndarray = ELEVATIONS_RAD, firings: int = 1808) -> Scan:
    """One clockwise turn in a room with a few pillars; range noise 2 cm, one return in twenty missing."""
    rng = np.random.default_rng(seed)
    rings = len(elevations_rad)
    azimuth = 0.7 - 2 * np.pi * np.arange(firings) * 55_296e-9 / 0.1
    a, e = np.meshgrid(azimuth, elevations_rad.astype(np.float64), indexing="ij")
    d = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    range_m = np.full(a.shape, np.inf)
    for axis, position in ((0, 12.0), (0, -9.0), (1, 7.0), (1, -14.0), (2, -1.5), (2, 6.0)):
        with np.errstate(divide="ignore"):
            hit = position / d[..., axis]
        range_m = np.where((hit > 0) & (hit < range_m), hit, range_m)
    for x, y, r in ((4.0, 2.0, 0.3), (-5.0, 3.0, 0.5), (2.0, -6.0, 0.4), (-3.0, -8.0, 0.8), (8.0, -3.0, 0.2)):
        along = (d[..., 0] * x + d[..., 1] * y) / np.cos(e) ** 2
        miss2 = x * x + y * y - (along * np.cos(e)) ** 2
        hit = along - np.sqrt(np.maximum(r * r - miss2, 0.0)) / np.cos(e)
        range_m = np.where((miss2 < r * r) & (hit > 0) & (hit < range_m), hit, range_m)
    intensity = 40 + 20 * (range_m.astype(np.int64) % 5) + rng.integers(-8, 9, a.shape)  # patches of unlike paint
    range_m = range_m + rng.normal(0, 0.02, a.shape)
    seen = rng.random(a.shape) > 0.05
    t = np.arange(firings)[:, None] * 55_296 + np.arange(rings) * 2_304
    ring = np.broadcast_to(np.arange(rings, dtype=np.uint8), a.shape)
    return Scan(
        stamp_ns=START_NS,
        end_ns=START_NS + int(t.max()),
        points_lidar=np.ascontiguousarray((d * range_m[..., None])[seen], np.float32),
        t_offset_ns=t[seen].astype(np.int32),
        ring=ring[seen].copy(),
        intensity=intensity[seen].astype(np.uint8),
    )


class KnownMotion:
    """Stands in for the Imu node: always the same motion."""

    def __init__(self, turn_radps: float = 2.3, speed_mps: float = 1.3) -> None:
        self.twist = np.array([0.1, 0.0, turn_radps, speed_mps, 0.1, 0.0])
        self.asked = 0

    def motion_over(self, start_ns: int, end_ns: int) -> Motion:
        self.asked += 1
        offsets = np.append(np.arange(0, end_ns - start_ns, 2_000_000), end_ns - start_ns).astype(np.int64)
        poses = [se3.exp(self.twist * (float(t) * 1e-9)) for t in offsets]
        return Motion(
            T_prev_lidar=se3.exp(0.1 * self.twist),
            covariance=np.diag([1e-6, 2e-6, 3e-6, 1e-4, 2e-4, 3e-4]),
            velocity_lidar_mps=self.twist[3:],
            knots=Knots(
                offsets, np.array([se3.so3_log(T[:3, :3]) for T in poses]), np.array([T[:3, 3] for T in poses])
            ),
            gravity_lidar=np.array([0.0, 0.6, -0.8]),
            gravity_sigma_rad=0.01,
            velocity_known=True,
        )


def make_pipeline(
    imu: KnownMotion, elevations_rad: np.ndarray = ELEVATIONS_RAD, columns: int = 1800, **settings: Any
) -> EdgePipeline:
    robot = cast(Robot, SimpleNamespace(lidar=SimpleNamespace(columns=columns)))
    return EdgePipeline(robot, PipelineSettings(**settings), elevations_rad, imu)
