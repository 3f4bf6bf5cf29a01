"""Kernels of the encoder of version 1: residuals of points, and their split into symbols and raw bits."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam.codec._beam_kernels import TIME_TOLERANCE_NS, matrix_at
from splitslam.codec._version1_kernels import FASTMATH, LIMIT, ROWS, TIME_UNIT_NS, blend, predict

__all__ = ["ROWS", "split", "to_residuals"]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def to_residuals(points, ring, column, t_offset_ns, per_column, table, directions, residuals):
    """residuals (5, N) int32 of points (N, 3) float32, deskewed, sorted by ring and column; False: out of range.

    per_column: ns a column, 1/256. table: (breaks_ns, base, slope). directions: (columns, 2) cos and sin of azimuth,
    (rings, 2) cos and sin of elevation, step_m.
    """
    breaks_ns, base, slope = table
    azimuths, elevations, step_m = directions
    M = np.empty(12)
    q, before = np.zeros(3, np.int64), np.zeros(3, np.int64)
    segment, row, last_column = 0, -1, 0
    t_decoded, first_t, first_column = 0, 0, 0
    fraction_a, fraction_b = 0, 0
    for i in range(len(points)):
        c = np.int64(column[i])
        starts = ring[i] != row
        if starts:
            row = np.int64(ring[i])
            residuals[0, i] = c
            t_expected = first_t + ((per_column * (c - first_column)) >> 8)
        else:
            residuals[0, i] = c - last_column
            t_expected = t_decoded + ((per_column * (c - last_column)) >> 8)
        last_column = c
        error = np.int64(t_offset_ns[i]) - t_expected
        correction = 0
        if abs(error) > TIME_TOLERANCE_NS:
            correction = (error + TIME_UNIT_NS // 2) // TIME_UNIT_NS
        residuals[4, i] = correction
        t_decoded = t_expected + TIME_UNIT_NS * correction
        if starts:
            first_t, first_column = t_decoded, c

        segment = matrix_at(t_decoded, segment, breaks_ns, base, slope, M)
        dx, dy, dz = points[i, 0] - M[3], points[i, 1] - M[7], points[i, 2] - M[11]
        x = M[0] * dx + M[4] * dy + M[8] * dz
        y = M[1] * dx + M[5] * dy + M[9] * dz
        z = M[2] * dx + M[6] * dy + M[10] * dz
        ca, sa, ce, se = azimuths[c, 0], azimuths[c, 1], elevations[row, 0], elevations[row, 1]
        level = ca * x + sa * y
        u, v, w = ce * level + se * z, ca * y - sa * x, ce * z - se * level
        if not max(abs(u), max(abs(v), abs(w))) < LIMIT * step_m:
            return False
        q[0] = np.int64(math.floor(u / step_m + 0.5))
        q[1] = np.int64(math.floor(v / step_m + 0.5))
        q[2] = np.int64(math.floor(w / step_m + 0.5))
        residuals[1, i] = q[0] - before[0]
        residuals[2, i] = q[1] - predict(fraction_a, q[0])
        residuals[3, i] = q[2] - predict(fraction_b, q[0])
        fraction_a, fraction_b = blend(fraction_a, q[0], q[1]), blend(fraction_b, q[0], q[2])
        before[0] = q[0]
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def split(values, signed, symbols, bits, position):
    """Splits values into one symbol byte each and raw bits for what the byte cannot hold; returns the new position.

    Below 64 (after zigzag, for signed rows) the symbol is the value. Above it is the exponent with three bits of
    mantissa, and the rest goes to `bits` (uint8, zeroed, LSB first) from bit `position` on. -1: a value is too large.
    """
    for i in range(len(values)):
        value = np.int64(values[i])
        u = ((value << 1) ^ (value >> 63)) if signed else value
        if u < 64:
            symbols[i] = u
            continue
        e = 6
        while u >> (e + 1):
            e += 1
        if e > 29:
            return -1
        symbols[i] = 64 + (e - 6) * 8 + ((u >> (e - 3)) & 7)
        for k in range(e - 3):
            bits[position >> 3] |= ((u >> k) & 1) << (position & 7)
            position += 1
    return position
