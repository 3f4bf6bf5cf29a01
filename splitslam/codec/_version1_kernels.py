"""Kernels of version 1: residuals from symbols and raw bits, points from residuals.

All prediction runs on integers that both sides have, so a decoder on another machine never drifts from its encoder.
Rows of a residual array: column, range, azimuth, elevation, time.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from splitslam.codec._beam_kernels import matrix_at

FASTMATH = {"contract", "nsz"}

ROWS = 5
LIMIT = 1 << 24  # steps a coordinate may have: 167 km at 1 cm
TIME_UNIT_NS = 40_000
_FRACTION = 20  # bits of the running direction residuals


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def blend(fraction, along, across):
    """The running direction residual (1 / 2^20) after a point with `across` steps at range `along`."""
    if along <= 0:
        return fraction
    seen = min(max((across << _FRACTION) // along, -(1 << _FRACTION)), 1 << _FRACTION)
    return fraction + ((seen - fraction) >> 2)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def predict(fraction, along):
    """Steps across that the running residual says at range `along`."""
    return (fraction * along + (1 << (_FRACTION - 1))) >> _FRACTION


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def from_residuals(residuals, ring, per_column, table, directions, points, column, t_offset_ns):
    """points (N, 3) float32, column and t_offset_ns of residuals (5, N) int32; False: not a valid frame.

    per_column: ns a column, 1/256. table: (breaks_ns, base, slope). directions: (columns, 2) cos and sin of azimuth,
    (rings, 2) cos and sin of elevation, step_m.
    """
    breaks_ns, base, slope = table
    azimuths, elevations, step_m = directions
    columns = len(azimuths)
    M = np.empty(12)
    segment, row, c = 0, -1, 0
    t_decoded, first_t, first_column = 0, 0, 0
    fraction_a, fraction_b, along = 0, 0, 0
    for i in range(len(points)):
        starts = ring[i] != row
        if starts:
            row = np.int64(ring[i])
            c = np.int64(residuals[0, i])
            t_expected = first_t + ((per_column * (c - first_column)) >> 8)
        else:
            c += np.int64(residuals[0, i])
            t_expected = t_decoded + ((per_column * np.int64(residuals[0, i])) >> 8)
        if c < 0 or c >= columns:
            return False
        t_decoded = t_expected + TIME_UNIT_NS * np.int64(residuals[4, i])
        if abs(t_decoded) > 2147483647:
            return False
        if starts:
            first_t, first_column = t_decoded, c

        along += np.int64(residuals[1, i])
        if abs(along) > LIMIT:
            return False
        a = predict(fraction_a, along) + np.int64(residuals[2, i])
        b = predict(fraction_b, along) + np.int64(residuals[3, i])
        if abs(a) > LIMIT or abs(b) > LIMIT:
            return False
        fraction_a, fraction_b = blend(fraction_a, along, a), blend(fraction_b, along, b)

        u, v, w = along * step_m, a * step_m, b * step_m
        ca, sa, ce, se = azimuths[c, 0], azimuths[c, 1], elevations[row, 0], elevations[row, 1]
        level = ce * u - se * w
        x, y, z = ca * level - sa * v, sa * level + ca * v, se * u + ce * w
        segment = matrix_at(t_decoded, segment, breaks_ns, base, slope, M)
        for r in range(3):
            points[i, r] = M[4 * r] * x + M[4 * r + 1] * y + M[4 * r + 2] * z + M[4 * r + 3]
        column[i] = c
        t_offset_ns[i] = t_decoded
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def join(symbols, signed, bits, position, values):
    """values of one symbol byte each and raw bits from bit `position` on; returns the new position, -1: ends too early.

    Below 64 (after zigzag, for signed rows) the symbol is the value. Above it is the exponent with three bits of
    mantissa, and the rest is in `bits` (uint8, LSB first).
    """
    end = 8 * len(bits)
    for i in range(len(symbols)):
        symbol = np.int64(symbols[i])
        u = symbol
        if symbol >= 64:
            e = 6 + ((symbol - 64) >> 3)
            if position + e - 3 > end:
                return -1
            u = (8 | ((symbol - 64) & 7)) << (e - 3)
            for k in range(e - 3):
                u |= ((np.int64(bits[position >> 3]) >> (position & 7)) & 1) << k
                position += 1
        values[i] = ((u >> 1) ^ -(u & 1)) if signed else u
    return position
