"""How version 1 has a frame's motion: knots on a grid, and the rest as a fixed block of floats."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.features import Knots, Motion

# 0.08 mm at 30 m, and 0.1 mm; times in whole microseconds
ROTATION_STEP_RAD = 5e-6
TRANSLATION_STEP_M = 1e-4
_TIME_STEP_NS = 1_000
MAX_KNOTS = 32
_LIMIT = 1 << 28

# T_prev_lidar as rotation vector and translation, velocity, gravity; sigmas of the covariance and of gravity
BLOCK = struct.Struct("<12f 7e")


def knots_from_integers(count: int, uniform: bool, integers: NDArray[np.int64]) -> Knots:
    """Knots of integer_count(count, uniform) integers; ValueError for times that do not increase."""
    used = 2 if uniform else count
    times = np.cumsum(np.cumsum(integers[:used])) * _TIME_STEP_NS
    offsets = _uniform(int(times[0]), int(times[-1]), count) if uniform else times
    if np.any(np.diff(offsets) <= 0):
        raise ValueError("knot times do not increase")
    steps = np.cumsum(np.cumsum(integers[used:].reshape(6, count).T, axis=0), axis=0).astype(np.float64)
    if np.any(np.abs(steps) >= _LIMIT):
        raise ValueError("knots move too far")
    return Knots(
        offsets,
        np.ascontiguousarray(steps[:, :3] * ROTATION_STEP_RAD),
        np.ascontiguousarray(steps[:, 3:] * TRANSLATION_STEP_M),
    )


def _uniform(first: int, last: int, count: int) -> NDArray[np.int64]:
    return first + (last - first) * np.arange(count, dtype=np.int64) // (count - 1)


def integer_count(count: int, uniform: bool) -> int:
    """How many integers `count` knots take."""
    return (2 if uniform else count) + 6 * count


def unpack_motion(block: bytes, knots: Knots, velocity_known: bool) -> Motion:
    """The motion of BLOCK.size bytes; ValueError when something is not finite."""
    floats = np.array(BLOCK.unpack(block))
    if not np.all(np.isfinite(floats)) or np.any(np.abs(floats) > 1e6):
        raise ValueError("motion is not finite")
    return Motion(
        T_prev_lidar=se3.compose(se3.so3_exp(floats[:3]), floats[3:6]),
        covariance=np.diag(floats[12:18] ** 2),
        velocity_lidar_mps=floats[6:9],
        knots=knots,
        gravity_lidar=floats[9:12],
        gravity_sigma_rad=float(floats[18]),
        velocity_known=velocity_known,
    )
