"""Kernels that predict knots from knots: what is left are small whole numbers, none where the motion is smooth."""

from __future__ import annotations

import numpy as np
from numba import njit

from splitslam.codec._coder_kernels import block, code_number
from splitslam.codec._jit import borrowing

FASTMATH = {"contract", "arcp", "nsz"}

# Units of the grid. Residuals are ten of them: a knot is off by at most 5e-6 rad and 0.1 mm, 0.15 mm each at 30 m.
ROTATION_UNIT_RAD = 1e-6
TRANSLATION_UNIT_M = 2e-5
COARSE = 10
TIME_UNIT_NS = 1_000
LIMIT = 1 << 28


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def to_units(rotation, translation_m, values):
    """values (K, 6) int64: rotation vectors and translations (K, 3) in whole units; False: not finite or too far."""
    for k in range(len(values)):
        for e in range(6):
            x = rotation[k, e] / ROTATION_UNIT_RAD if e < 3 else translation_m[k, e - 3] / TRANSLATION_UNIT_M
            if not abs(x) < LIMIT:
                return False
            values[k, e] = round(x)
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def from_units(values, rotation, translation_m):
    """The inverse of to_units."""
    for k in range(len(values)):
        for e in range(3):
            if max(abs(values[k, e]), abs(values[k, 3 + e])) >= LIMIT:
                return False
            rotation[k, e] = values[k, e] * ROTATION_UNIT_RAD
            translation_m[k, e] = values[k, 3 + e] * TRANSLATION_UNIT_M
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _even_time(times, k):
    last = len(times) - 1
    return times[0] + (times[last] - times[0]) * k // last


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def are_even(times):
    """Whether times (K,) are evenly spaced."""
    off = 0
    for k in range(len(times)):
        off += times[k] != _even_time(times, k)
    return off == 0


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def fill_evenly(times):
    """times (K,) between the first and the last, evenly spaced."""
    for k in range(1, len(times) - 1):
        times[k] = _even_time(times, k)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _settle(values, k, e, expected, residual, decoding):
    """values[k, e] becomes the nearest that can be coded; returns the residual."""
    if not decoding:
        residual = (values[k, e] - expected + COARSE // 2) // COARSE
    values[k, e] = expected + COARSE * residual
    return residual


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def halve(values, residuals, decoding):
    """values (2^m + 1, 6) int64 of evenly spaced knots <-> residuals (6 (2^m + 1),) int64.

    The ends first, then the middle of each gap from the cubic through the two knots on either side (a parabola at the
    ends, a line between two), coarse to fine, so that smooth motion leaves zeros. Settles values while encoding.
    """
    last, n = len(values) - 1, 0
    for e in range(6):
        residuals[n] = _settle(values, 0, e, np.int64(0), residuals[n], decoding)
        residuals[n + 1] = _settle(values, last, e, values[0, e], residuals[n + 1], decoding)
        n += 2
    gap = last
    while gap > 1:
        for k in range(gap // 2, last, gap):
            a, b = k - gap // 2, k + gap // 2
            for e in range(6):
                near = values[a, e] + values[b, e]
                if a >= gap and b + gap <= last:
                    expected = (9 * near - values[a - gap, e] - values[b + gap, e] + 8) >> 4
                elif a >= gap:
                    expected = (6 * values[a, e] + 3 * values[b, e] - values[a - gap, e] + 4) >> 3
                elif b + gap <= last:
                    expected = (3 * values[a, e] + 6 * values[b, e] - values[b + gap, e] + 4) >> 3
                else:
                    expected = near >> 1
                residuals[n] = _settle(values, k, e, expected, residuals[n], decoding)
                n += 1
        gap //= 2


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def continue_rate(times, values, residuals, decoding):
    """values (K, 6) int64 of knots at times (K,) int64 <-> residuals (6 K,): each knot continues the last rate."""
    n = 0
    for k in range(len(values)):
        for e in range(6):
            expected = values[k - 1, e] if k > 0 else np.int64(0)
            if k > 1:
                step, before = times[k] - times[k - 1], times[k - 1] - times[k - 2]
                expected += ((values[k - 1, e] - values[k - 2, e]) * step) // before
            residuals[n] = _settle(values, k, e, expected, residuals[n], decoding)
            n += 1


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def settle(times, even, rotation, translation_m):
    """Knots (K, 3) at times (K,) become the nearest that can be coded, see `halve`; False: not finite or too far."""
    values, residuals = np.empty((len(times), 6), np.int64), np.empty(6 * len(times), np.int64)
    if not to_units(rotation, translation_m, values):
        return False
    if even:
        halve(values, residuals, False)
    else:
        continue_rate(times, values, residuals, False)
    return from_units(values, rotation, translation_m)


@borrowing
def code_times(state, data, model, context, times, even):
    """times (K,) int64, ns: as second differences in whole units; of even ones the first and the last. False: they do
    not increase, or are beyond 18 minutes.
    """
    last = len(times) - 1
    time, step = np.int64(0), np.int64(0)
    for k in range(len(times)):
        if not even or k == 0 or k == last:
            change = times[k] // TIME_UNIT_NS - time - step
            where = block(context, context + 1, context + 2, context)
            step += code_number(state, data, model, where, change, True, 1, 2)
            time += step
            times[k] = time * TIME_UNIT_NS
    if even:
        fill_evenly(times)
    for k in range(1, len(times)):
        if times[k] <= times[k - 1]:
            return False
    return max(abs(times[0]), abs(times[last])) <= 1 << 40
