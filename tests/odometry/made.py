"""A robot in a made room: frames of exact points, and a map service whose answers a test may hold up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge_agent.types import OdometryReply
from splitslam import se3
from splitslam.features import FeatureFrame, FeatureSet, Knots, Motion
from tests.map_pipeline.naive import room

Array = NDArray[np.float64]
SCAN_NS = 100_000_000
NO_AXES = np.zeros((0, 6))
WRONG_MOTION = np.array([0.001, -0.001, 0.004, 0.02, -0.01, 0.005])  # what each prediction is off by, the same way
RNG = np.random.default_rng(11)
SURFS, CORNERS = room(RNG, 12_000, 0.0)


def pose(seq: int) -> Array:
    """T_odom_lidar: a slow bend through the room, 0.6 m/s."""
    return se3.exp(np.array([0, 0, 0.02 * seq, 0.06 * seq, 0.0, 0.0])) @ se3.exp(np.array([0, 0, 0, -1.0, 0, 1.0]))


def features(points: Array, T: Array, count: int) -> FeatureSet:
    """`count` of the points, with 1 cm of noise, as seen from T."""
    chosen = points[RNG.choice(len(points), min(count, len(points)), replace=False)]
    back = se3.inv(T)
    seen = (chosen @ back[:3, :3].T + back[:3, 3] + RNG.normal(0, 0.01, chosen.shape)).astype(np.float32)
    n = len(seen)
    return FeatureSet(seen, np.zeros(n, np.uint8), np.zeros(n, np.uint16), np.zeros(n, np.int32), np.zeros(n, np.uint8))


def frame(seq: int, surfs: Array = SURFS, corners: Array = CORNERS, points: int = 1200) -> FeatureFrame:
    """Every fifth is dense. The motion is that of a poor IMU."""
    T = pose(seq)
    moved = se3.inv(pose(seq - 1)) @ T @ se3.exp(WRONG_MOTION)
    knots = Knots(np.array([0, SCAN_NS], np.int64), np.zeros((2, 3)), np.zeros((2, 3)))
    covariance = np.diag(np.repeat([0.005**2, 0.03**2], 3))
    motion = Motion(moved, covariance, np.zeros(3), knots, np.array([0.0, 0.0, -1.0]), 0.01, True)
    found = features(corners, T, points // 4), features(surfs, T, points)
    return FeatureFrame(seq, seq * SCAN_NS, seq % 5 == 1, motion, *found)


def answer(seq: int, T_server_odom: Array | None = None, T_map_odom: Array | None = None) -> OdometryReply:
    """The service's to a frame, exact, in a frame of its own: T_server_odom; T_map_odom: its correction so far."""
    T_server_lidar = (np.eye(4) if T_server_odom is None else T_server_odom) @ pose(seq)
    T_map = np.eye(4) if T_map_odom is None else T_map_odom
    return OdometryReply(seq, seq * SCAN_NS, T_map @ T_server_lidar, T_map, np.eye(6) * 1e-6, 2, NO_AXES)


def without_points(made: FeatureFrame) -> FeatureFrame:
    """The same scan with nothing in it."""
    none = features(SURFS, np.eye(4), 0)
    return replace(made, corners=none, surfs=none)
