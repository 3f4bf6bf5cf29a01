"""Kernels that predict knots from knots: what is left are small whole numbers, none where the motion is smooth."""

from __future__ import annotations

import numpy as np
from numba import njit

FASTMATH = {"contract", "arcp", "nsz"}

COARSE = 10  # a residual stands for so many units: knots are coded to +-5 of them


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
