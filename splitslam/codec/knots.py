"""Knots on the wire's grid: what quantise_knots makes of them, and how they pass through the coder."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam import _motion_kernels
from splitslam.codec import _knot_kernels as kernels
from splitslam.codec.coder import KNOTS, TIMES, Coder
from splitslam.features import Knots

_TIME_UNIT_NS = kernels.TIME_UNIT_NS
# Up to 32 knots stay where they are: between the samples of a slow IMU the rate steps, and resampling would round the
# corner off. A faster IMU is resampled to a power of two of intervals. Chords of 3.3 ms err by less than 1 mm at 30 m
# when a head turns at up to 131 deg/s and back within a second.
_SPACING_NS = 3_300_000
_KEPT = 32
MAX_KNOTS = 33


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
    if not kernels.settle(times, _halves(times), rotation, translation):
        raise ValueError("knots that are not finite or move too far")
    return Knots(times, rotation, translation)


def code_knots(coder: Coder, knots: Knots | None) -> Knots:
    """Knots as they travel, or those that are decoded; ValueError for ones that do not fit or increase in time."""
    decoding, count, even = knots is None, 0, False
    if knots is not None:
        count, even = len(knots.offsets_ns), _halves(knots.offsets_ns)
        if not 2 <= count <= MAX_KNOTS:
            raise ValueError(f"{count} knots, expected 2 to {MAX_KNOTS}")
    count, even = coder.fields(np.array([count, even], np.int64), (6, 1)).tolist()
    if not 2 <= count <= MAX_KNOTS or (even and (count - 1) & (count - 2)):
        raise ValueError(f"{count} knots")

    times, values, residuals = np.empty(count, np.int64), np.empty((count, 6), np.int64), np.empty(6 * count, np.int64)
    if knots is not None:
        times[:] = knots.offsets_ns
        _to_units(knots.rotation, knots.translation_m, values)
        _predict(times, values, residuals, False, bool(even))
    if not kernels.code_times(*coder.arrays, TIMES, times, bool(even)):
        raise ValueError("knot times do not increase")
    coder.numbers(residuals, KNOTS)
    if decoding:
        _predict(times, values, residuals, True, bool(even))
    rotation, translation_m = np.empty((count, 3)), np.empty((count, 3))
    if not kernels.from_units(values, rotation, translation_m):
        raise ValueError("knots move too far")
    return Knots(times, rotation, translation_m)


def _predict(
    times: NDArray[np.int64], values: NDArray[np.int64], residuals: NDArray[np.int64], decoding: bool, even: bool
) -> None:
    if even:
        kernels.halve(values, residuals, decoding)
    else:
        kernels.continue_rate(times, values, residuals, decoding)


def _to_units(rotation: NDArray[np.float64], translation_m: NDArray[np.float64], values: NDArray[np.int64]) -> None:
    if not kernels.to_units(rotation, translation_m, values):
        raise ValueError("knots that are not finite or move too far")


def _halves(offsets_ns: NDArray[np.int64]) -> bool:
    """Whether they are evenly spaced, with a power of two of intervals."""
    count = len(offsets_ns)
    if count < 2 or count > MAX_KNOTS or (count - 1) & (count - 2):
        return False
    return kernels.are_even(offsets_ns)


def _even(first: int, last: int, count: int) -> NDArray[np.int64]:
    times = np.full(count, first)
    times[-1] = last
    kernels.fill_evenly(times)
    return times
