"""How a frame's motion travels: knots on a wire grid, and the rest as a fixed block of floats."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from splitslam import _motion_kernels as kernels
from splitslam import se3
from splitslam.features import Knots, Motion

# 0.08 mm at 30 m, and 0.1 mm; times in whole microseconds
ROTATION_STEP_RAD = 5e-6
TRANSLATION_STEP_M = 1e-4
_TIME_STEP_NS = 1_000
# Up to 32 knots stay where they are: between the samples of a slow IMU the rate steps, and resampling would round the
# corner off. A faster IMU is resampled: chords of 3.3 ms err by less than 1 mm at 30 m when a head turns at up to
# 131 deg/s and back within a second.
_SPACING_NS = 3_300_000
MAX_KNOTS = 32
_LIMIT = 1 << 28

# T_prev_lidar as rotation vector and translation, velocity, gravity; sigmas of the covariance and of gravity
BLOCK = struct.Struct("<12f 7e")
_LARGEST_HALF = 65_504.0


def quantise_knots(knots: Knots) -> Knots:
    """The knots as they travel: on the wire's grid, at most 32. Idempotent; both sides deskew with the result."""
    offsets = knots.offsets_ns
    first = int(offsets[0]) // _TIME_STEP_NS * _TIME_STEP_NS
    last = max(-(-int(offsets[-1]) // _TIME_STEP_NS) * _TIME_STEP_NS, first + _TIME_STEP_NS)
    if len(offsets) <= MAX_KNOTS and first == offsets[0] and last == offsets[-1] and _is_uniform(offsets):
        times = offsets
    elif len(offsets) <= MAX_KNOTS:
        times = np.unique(np.concatenate([[first], offsets[1:-1] // _TIME_STEP_NS * _TIME_STEP_NS, [last]]))
    else:
        count = min(max(-(-(last - first) // _SPACING_NS) + 1, 2), MAX_KNOTS)
        times = _uniform(first, last, count)
    rotation, translation = np.empty((len(times), 3)), np.empty((len(times), 3))
    kernels.resample(offsets, knots.rotation, knots.translation_m, times, rotation, translation)
    return Knots(
        times,
        np.rint(rotation / ROTATION_STEP_RAD) * ROTATION_STEP_RAD,
        np.rint(translation / TRANSLATION_STEP_M) * TRANSLATION_STEP_M,
    )


def _uniform(first: int, last: int, count: int) -> NDArray[np.int64]:
    return first + (last - first) * np.arange(count, dtype=np.int64) // (count - 1)


def _is_uniform(offsets_ns: NDArray[np.int64]) -> bool:
    return bool(np.array_equal(offsets_ns, _uniform(int(offsets_ns[0]), int(offsets_ns[-1]), len(offsets_ns))))


def knots_to_integers(knots: Knots) -> tuple[bool, NDArray[np.int64]]:
    """(evenly spaced, what the decoder needs beside their number); ValueError for knots that do not fit."""
    offsets = knots.offsets_ns
    uniform = _is_uniform(offsets)
    times = offsets[[0, -1]] if uniform else offsets
    times = np.diff(np.diff(times // _TIME_STEP_NS, prepend=0), prepend=0)
    values = np.hstack([knots.rotation / ROTATION_STEP_RAD, knots.translation_m / TRANSLATION_STEP_M])
    if not 2 <= len(offsets) <= MAX_KNOTS or not np.all(np.abs(values) < _LIMIT):
        raise ValueError(f"{len(offsets)} knots that are not finite, move too far or are not 2 to {MAX_KNOTS}")
    steps = np.rint(values).astype(np.int64)
    second = np.diff(np.diff(steps, axis=0, prepend=0), axis=0, prepend=0)
    return uniform, np.concatenate([times, second.T.reshape(-1)])


def knots_from_integers(count: int, uniform: bool, integers: NDArray[np.int64]) -> Knots:
    """The inverse; integers has integer_count(count, uniform) entries. ValueError for times that do not increase."""
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


def integer_count(count: int, uniform: bool) -> int:
    """How many integers `count` knots take."""
    return (2 if uniform else count) + 6 * count


def pack_motion(motion: Motion) -> bytes:
    """All but the knots, BLOCK.size bytes; ValueError when something is not finite."""
    floats = np.concatenate(
        [
            se3.so3_log(motion.T_prev_lidar[:3, :3]),
            motion.T_prev_lidar[:3, 3],
            motion.velocity_lidar_mps,
            motion.gravity_lidar,
            np.minimum(np.sqrt(np.diagonal(motion.covariance)), _LARGEST_HALF),
            [min(motion.gravity_sigma_rad, _LARGEST_HALF)],
        ]
    )
    if not np.all(np.isfinite(floats)):
        raise ValueError("motion is not finite")
    return BLOCK.pack(*floats)


def unpack_motion(block: bytes, knots: Knots, velocity_known: bool) -> Motion:
    """The inverse of pack_motion; ValueError when something is not finite."""
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
