"""Knots on the wire's grid: what quantise_knots makes of them, and how they pass through the coder."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam import _motion_kernels
from splitslam.codec import _knot_kernels as kernels
from splitslam.codec.coder import KNOTS, Coder
from splitslam.features import Knots

# Units of the grid. Residuals are ten of them: a knot is off by at most 5e-6 rad and 0.1 mm, 0.15 mm each at 30 m.
ROTATION_UNIT_RAD = 1e-6
TRANSLATION_UNIT_M = 2e-5
_TIME_UNIT_NS = 1_000
# Up to 32 knots stay where they are: between the samples of a slow IMU the rate steps, and resampling would round the
# corner off. A faster IMU is resampled to a power of two of intervals. Chords of 3.3 ms err by less than 1 mm at 30 m
# when a head turns at up to 131 deg/s and back within a second.
_SPACING_NS = 3_300_000
_KEPT = 32
MAX_KNOTS = 33
_LIMIT = 1 << 28


def quantise_knots(knots: Knots) -> Knots:
    """The knots as they travel: on the wire's grid, at most 33. Idempotent; both sides deskew with the result."""
    offsets = knots.offsets_ns
    first = int(offsets[0]) // _TIME_UNIT_NS * _TIME_UNIT_NS
    last = max(-(-int(offsets[-1]) // _TIME_UNIT_NS) * _TIME_UNIT_NS, first + _TIME_UNIT_NS)
    if _halves(offsets) and first == offsets[0] and last == offsets[-1]:
        times = offsets
    elif len(offsets) <= _KEPT:
        times = np.unique(np.concatenate([[first], offsets[1:-1] // _TIME_UNIT_NS * _TIME_UNIT_NS, [last]]))
    else:
        intervals = 1 << (min(-(-(last - first) // _SPACING_NS), MAX_KNOTS - 1) - 1).bit_length()
        times = _even(first, last, intervals + 1)
    rotation, translation = np.empty((len(times), 3)), np.empty((len(times), 3))
    _motion_kernels.resample(offsets, knots.rotation, knots.translation_m, times, rotation, translation)
    values = _values(rotation, translation)
    _predict(times, values, np.empty(values.size, np.int64), False)
    return _knots(times, values)


def code_knots(coder: Coder, knots: Knots | None) -> Knots:
    """Quantised knots, or those that are decoded; ValueError for ones that do not fit or do not increase in time."""
    if knots is None:
        times, values, count, even = np.empty(0, np.int64), np.empty((0, 6), np.int64), 0, False
    else:
        times, values = knots.offsets_ns, _values(knots.rotation, knots.translation_m)
        count, even = len(times), _halves(times)
    if knots is not None and not 2 <= count <= MAX_KNOTS:
        raise ValueError(f"{count} knots, expected 2 to {MAX_KNOTS}")
    count, even = coder.fields([count, int(even)], (6, 1))
    if not 2 <= count <= MAX_KNOTS or (even and (count - 1) & (count - 2)):
        raise ValueError(f"{count} knots")

    used = times[[0, -1]] if knots is not None and even else times
    steps = np.diff(np.diff(used, prepend=0) // _TIME_UNIT_NS, prepend=0)
    steps = coder.numbers(steps if knots is not None else np.empty(2 if even else count, np.int64))
    moments = np.cumsum(np.cumsum(steps)) * _TIME_UNIT_NS
    times = _even(int(moments[0]), int(moments[-1]), count) if even else moments
    if np.any(np.diff(times) <= 0) or np.any(np.abs(times) > 1 << 40):
        raise ValueError("knot times do not increase")

    residuals = np.empty(6 * count, np.int64)
    if knots is None:
        values = np.empty((count, 6), np.int64)
        _predict(times, values, coder.numbers(residuals, KNOTS), True)
    else:
        _predict(times, values, residuals, False)
        coder.numbers(residuals, KNOTS)
    if np.any(np.abs(values) >= _LIMIT):
        raise ValueError("knots move too far")
    return _knots(times, values)


def _predict(times: NDArray[np.int64], values: NDArray[np.int64], residuals: NDArray[np.int64], decoding: bool) -> None:
    if _halves(times):
        kernels.halve(values, residuals, decoding)
    else:
        kernels.continue_rate(times, values, residuals, decoding)


def _values(rotation: NDArray[np.float64], translation_m: NDArray[np.float64]) -> NDArray[np.int64]:
    values = np.hstack([rotation / ROTATION_UNIT_RAD, translation_m / TRANSLATION_UNIT_M])
    if not np.all(np.abs(values) < _LIMIT):
        raise ValueError("knots that are not finite or move too far")
    return np.rint(values).astype(np.int64)


def _knots(times: NDArray[np.int64], values: NDArray[np.int64]) -> Knots:
    parts = values.astype(np.float64)
    rotation, translation_m = parts[:, :3] * ROTATION_UNIT_RAD, parts[:, 3:] * TRANSLATION_UNIT_M
    return Knots(times, np.ascontiguousarray(rotation), np.ascontiguousarray(translation_m))


def _halves(offsets_ns: NDArray[np.int64]) -> bool:
    """Whether they are evenly spaced, with a power of two of intervals."""
    count = len(offsets_ns)
    if count < 2 or count > MAX_KNOTS or (count - 1) & (count - 2):
        return False
    return bool(np.array_equal(offsets_ns, _even(int(offsets_ns[0]), int(offsets_ns[-1]), count)))


def _even(first: int, last: int, count: int) -> NDArray[np.int64]:
    return first + (last - first) * np.arange(count, dtype=np.int64) // (count - 1)
