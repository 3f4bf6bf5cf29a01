"""A town without end, made of blocks, as one sensor sees it: cheap frames for sessions of any length.

Every 25 m square holds a block, shifted and sized by a hash of the square; the robot drives a large circle on streets
between them. Rays meet the ground and the blocks' walls; nothing moves, nothing is noisy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.features import FeatureFrame, FeatureSet, Knots, Motion

FRAME_NS = 100_000_000
KEYFRAME_STEP_M = 1.0
_RADIUS_M = 500.0
_SQUARE_M = 25.0
_COLUMNS = 360
_REACH_M = 60.0
_HEIGHT_M = 1.5
_EDGE_M = 0.25
Array = NDArray[np.float64]


def pose(seq: int) -> Array:
    """T_world_lidar (4, 4) of frame `seq`: a metre a frame along a circle."""
    angle = seq * KEYFRAME_STEP_M / _RADIUS_M
    T = se3.exp(np.array([0, 0, angle + np.pi / 2, 0, 0, 0]))
    T[:3, 3] = _RADIUS_M * np.cos(angle), _RADIUS_M * np.sin(angle), 0.0
    return T


def block_frame(seq: int, beams_rad: NDArray[np.float32]) -> FeatureFrame:
    """What an edge would send of scan `seq`; dense, with the true motion."""
    T = pose(seq)
    ring, column = np.divmod(np.arange(len(beams_rad) * _COLUMNS), _COLUMNS)
    azimuth, elevation = 2 * np.pi * column / _COLUMNS, beams_rad[ring].astype(float)
    ray = np.column_stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    ray_world = ray @ T[:3, :3].T
    range_m, corner = _cast(T[:3, 3], ray_world)
    points = (ray * range_m[:, None]).astype(np.float32)
    seen = range_m < _REACH_M

    def features(chosen: NDArray[np.bool_]) -> FeatureSet:
        n = int(chosen.sum())
        return FeatureSet(
            np.ascontiguousarray(points[chosen]),
            ring[chosen].astype(np.uint8),
            (column[chosen] * 5).astype(np.uint16),
            np.zeros(n, np.int32),
            np.full(n, 100, np.uint8),
        )

    motion = np.eye(4) if seq == 1 else se3.inv(pose(seq - 1)) @ T
    knots = Knots(np.array([0, FRAME_NS], np.int64), np.zeros((2, 3)), np.zeros((2, 3)))
    told = Motion(motion, np.eye(6) * 1e-4, np.zeros(3), knots, np.array([0.0, 0.0, -1.0]), 0.01, True)
    return FeatureFrame(seq, seq * FRAME_NS, True, told, features(seen & corner), features(seen & ~corner))


def _cast(origin: Array, rays: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Range of each ray, m, and whether it ends at an upright edge of a block."""
    with np.errstate(divide="ignore", invalid="ignore"):
        range_m = np.where(rays[:, 2] < -1e-3, -_HEIGHT_M / rays[:, 2], np.inf)
        corner = np.zeros(len(rays), bool)
        inverse = 1.0 / np.where(np.abs(rays[:, :2]) < 1e-9, 1e-9, rays[:, :2])
        for low, high in _blocks(origin):
            near, far = (low - origin[:2]) * inverse, (high - origin[:2]) * inverse
            enter = np.minimum(near, far).max(axis=1)
            leave = np.maximum(near, far).min(axis=1)
            hit = (enter < leave) & (enter > 0.1) & (enter < range_m)
            range_m = np.where(hit, enter, range_m)
            at = origin[:2] + rays[:, :2] * enter[:, None]
            off = np.minimum(np.abs(at - low), np.abs(at - high))
            corner = np.where(hit, off.max(axis=1) < _EDGE_M, corner)
    return np.minimum(range_m, 1e6), corner


def _blocks(origin: Array) -> list[tuple[Array, Array]]:
    """Low and high corners (2,) of the blocks within reach, none on the robot's way."""
    reach = int(_REACH_M // _SQUARE_M) + 1
    i0, j0 = (int(v // _SQUARE_M) for v in origin[:2])
    blocks = []
    for i in range(i0 - reach, i0 + reach + 1):
        for j in range(j0 - reach, j0 + reach + 1):
            dice = np.random.default_rng((i & 0xFFFF, j & 0xFFFF)).uniform(size=4)
            centre = (np.array([i, j]) + 0.3 + 0.4 * dice[:2]) * _SQUARE_M
            if abs(float(np.linalg.norm(centre)) - _RADIUS_M) > 12.0:
                size = 2.0 + 4.0 * dice[2:]
                blocks.append((centre - size, centre + size))
    return blocks
