"""A town without end as features, sampled where a LiDAR would find them: sessions of hours, without a ray being cast.

Every 25 m square holds a block, shifted and sized by a hash of the square, but for those in the robot's way. A scan is
so many points on the walls and the ground around, more of them where they are near, and on the blocks' upright edges;
one sees through blocks. Each scan's points are new, 1 cm inexact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.features import FeatureFrame, FeatureSet, Knots, Motion

FRAME_NS = 100_000_000
_SQUARE_M, _REACH_M, _SENSOR_M, _HIGH_M = 25.0, 40.0, 1.5, 5.0
_CLEAR_M = 4.0  # between the way and the walls
_NOISE_M = 0.01
_MOTION_M, _MOTION_RAD = 0.002, 2e-4  # sigma of the edge's motion
_DENSE_M, _DENSE_RAD = 1.0, 0.2
Array = NDArray[np.float64]
Way = Callable[[float], Array]  # s -> T_world_lidar (4, 4)


@dataclass(frozen=True, slots=True)
class Counts:
    """Features of a frame: corners, surfs."""

    sparse: tuple[int, int] = (200, 800)
    dense: tuple[int, int] = (400, 3600)


class Town:
    """clear(p, m): is a place (2,) so far from the robot's way that a block of radius m may stand there?"""

    def __init__(self, clear: Callable[[Array, float], bool]) -> None:
        self._clear = clear
        self._near: tuple[int, int] | None = None
        self._walls = np.zeros((0, 4))  # from (x, y) along (x, y)

    def around(self, position_m: Array) -> Array:
        """(n, 4) walls around: where they begin, and the way to where they end, m."""
        i, j = (int(v // _SQUARE_M) for v in position_m[:2])
        if (i, j) != self._near:
            reach = int(_REACH_M // _SQUARE_M) + 1
            squares = [(i + a, j + b) for a in range(-reach, reach + 1) for b in range(-reach, reach + 1)]
            self._near, self._walls = (i, j), np.concatenate([self._block(*square) for square in squares])
        return self._walls

    def _block(self, i: int, j: int) -> Array:
        dice = np.random.default_rng((i & 0xFFFF, j & 0xFFFF)).uniform(size=5)
        centre = (np.array([i, j]) + 0.35 + 0.3 * dice[:2]) * _SQUARE_M
        half, turn = 2.5 + 3.0 * dice[2:4], np.pi * dice[4]
        if not self._clear(centre, float(np.hypot(*half)) + _CLEAR_M):
            return np.zeros((0, 4))
        c, s = np.cos(turn), np.sin(turn)
        corners = centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ np.array([[c, s], [-s, c]])
        return np.hstack([corners, np.roll(corners, -1, axis=0) - corners])


class Robot:
    """Frames of a robot that drives `way` through `town`, as an edge agent with a good IMU would send them."""

    def __init__(self, town: Town, way: Way, seed: int = 1, counts: Counts = Counts()) -> None:
        self._town, self._way, self._counts = town, way, counts
        self._rng = np.random.default_rng(seed)
        self._last = self._last_dense = way(0.0)
        self._knots = Knots(np.array([0, FRAME_NS], np.int64), np.zeros((2, 3)), np.zeros((2, 3)))
        self._covariance = np.diag(np.repeat([_MOTION_RAD**2, _MOTION_M**2], 3))

    def frame(self, seq: int) -> FeatureFrame:
        """The next one: call it with 1, 2, 3, ..."""
        T = self._way(seq * FRAME_NS * 1e-9)
        since_dense = se3.inv(self._last_dense) @ T
        dense = seq == 1 or np.linalg.norm(since_dense[:3, 3]) >= _DENSE_M or se3.angle(since_dense) >= _DENSE_RAD
        if dense:
            self._last_dense = T
        noise = self._rng.normal(0.0, np.repeat([_MOTION_RAD, _MOTION_M], 3))
        moved = se3.inv(self._last) @ T @ se3.exp(noise) if seq > 1 else np.eye(4)
        self._last = T
        down = -T[2, :3]
        motion = Motion(moved, self._covariance, np.zeros(3), self._knots, down, 0.002, True)
        corners, surfs = self._points(T, *(self._counts.dense if dense else self._counts.sparse))
        return FeatureFrame(seq, seq * FRAME_NS, bool(dense), motion, _features(corners), _features(surfs))

    def _points(self, T_world_lidar: Array, corners: int, surfs: int) -> tuple[Array, Array]:
        """(corners, 3) and (surfs, 3) of the town, frame `lidar`."""
        rng, here = self._rng, T_world_lidar[:3, 3]
        walls = self._town.around(here)
        away_m = np.linalg.norm(walls[:, :2] + walls[:, 2:] / 2.0 - here[:2], axis=1)
        length_m = np.linalg.norm(walls[:, 2:], axis=1)
        weight = np.where(away_m < _REACH_M, length_m / (away_m + 5.0) ** 2, 0.0)
        upright = rng.choice(len(walls), corners, p=weight / weight.sum())
        edges = np.column_stack([walls[upright, :2], rng.uniform(-_SENSOR_M, _HIGH_M, corners)])
        ground = surfs // 3
        flat = rng.choice(len(walls), surfs - ground, p=weight / weight.sum())
        along, up_m = rng.uniform(size=(len(flat), 1)), rng.uniform(-_SENSOR_M, _HIGH_M, len(flat))
        faces = np.column_stack([walls[flat, :2] + along * walls[flat, 2:], up_m])
        bearing, range_m = rng.uniform(0.0, 2.0 * np.pi, ground), 2.0 + 18.0 * rng.uniform(size=ground) ** 1.5
        floor = np.column_stack([np.cos(bearing) * range_m, np.sin(bearing) * range_m, np.full(ground, -_SENSOR_M)])
        floor[:, :2] += here[:2]
        return self._seen(T_world_lidar, edges), self._seen(T_world_lidar, np.concatenate([faces, floor]))

    def _seen(self, T_world_lidar: Array, points_world: Array) -> Array:
        noisy = points_world + self._rng.normal(0.0, _NOISE_M, points_world.shape)
        return (noisy - T_world_lidar[:3, 3]) @ T_world_lidar[:3, :3]


def _features(points_lidar: Array) -> FeatureSet:
    n = len(points_lidar)
    zeros = np.zeros(n, np.uint8), np.zeros(n, np.uint16), np.zeros(n, np.int32), np.full(n, 100, np.uint8)
    return FeatureSet(np.ascontiguousarray(points_lidar, np.float32), *zeros)


# --- ways ------------------------------------------------------------------------------------------------------------


def straight_on(speed_mps: float) -> tuple[Town, Way]:
    """New ground for ever: a street that winds by 3 m."""

    def way(t_s: float) -> Array:
        x = speed_mps * t_s
        return _level(x, 3.0 * np.sin(x / 25.0), np.arctan(3.0 / 25.0 * np.cos(x / 25.0)))

    return Town(lambda p, m: abs(p[1]) > 3.0 + m), way


def round_and_round(lap_m: float, speed_mps: float, parked_s: tuple[float, float] = (0.0, 0.0)) -> tuple[Town, Way]:
    """The same circle again and again, never quite on the same line; it stands from parked_s[0] to parked_s[1]."""
    radius = lap_m / (2.0 * np.pi)
    begin_s, end_s = parked_s

    def way(t_s: float) -> Array:
        driven_s = t_s if t_s < begin_s else max(begin_s, t_s - (end_s - begin_s))
        angle = speed_mps * driven_s / radius
        r = radius + 0.2 * np.sin(angle / 2.7)
        return _level(r * np.cos(angle), r * np.sin(angle), angle + np.pi / 2.0)

    return Town(lambda p, m: abs(float(np.hypot(*p)) - radius) > 0.2 + m), way


def _level(x: float, y: float, yaw: float) -> Array:
    return se3.compose(se3.so3_exp(np.array([0.0, 0.0, yaw])), np.array([x, y, 0.0]))
