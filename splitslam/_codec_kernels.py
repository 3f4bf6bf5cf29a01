"""Kernels of the feature codec: residuals, their split into symbols and raw bits, and the way back.

All prediction runs on integers that both sides have, so a decoder on another machine never drifts from its encoder.
Rows of a residual array: column, range, azimuth, elevation, time.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

FASTMATH = {"contract", "nsz"}

ROWS = 5
LIMIT = 1 << 24  # steps a coordinate may have: 167 km at 1 cm
TIME_UNIT_NS = 40_000
TIME_TOLERANCE_NS = 50_000
_FRACTION = 20  # bits of the running direction residuals


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def merge(ring_a, column_a, ring_b, column_b, order):
    """order (A + B,) int32: the merge of two sets sorted by ring, then column (index, B's shifted by A).

    Returns False when one is not sorted.
    """
    na, nb = len(ring_a), len(ring_b)
    a, b, previous = 0, 0, -1
    for n in range(na + nb):
        key_a = (np.int64(ring_a[a]) << 16) + np.int64(column_a[a]) if a < na else 1 << 40
        key_b = (np.int64(ring_b[b]) << 16) + np.int64(column_b[b]) if b < nb else 1 << 40
        key = min(key_a, key_b)
        if key < previous:
            return False
        previous = key
        if key_a <= key_b:
            order[n] = a
            a += 1
        else:
            order[n] = na + b
            b += 1
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def matrix_at(t, s, breaks_ns, base, slope, M):
    """M (12,) float64: the motion table's matrix at t; returns the segment, found by walking from segment s."""
    last = len(base) - 1
    t = min(max(t, breaks_ns[0]), breaks_ns[last + 1])
    while t < breaks_ns[s]:
        s -= 1
    while s < last and t >= breaks_ns[s + 1]:
        s += 1
    dt = float(t - breaks_ns[s])
    for e in range(12):
        M[e] = base[s, e] + slope[s, e] * dt
    return s


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
def from_residuals(residuals, ring, per_column, table, directions, points, column, t_offset_ns):
    """The inverse of to_residuals: fills points (N, 3) float32, column and t_offset_ns; False: not a valid frame."""
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


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def join(symbols, signed, bits, position, values):
    """The inverse of split; -1: `bits` ends too early."""
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


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def neighbour_rates(ring, column, t_offset_ns, rates):
    """rates (N,) float64: ns a column between close neighbours in a ring; returns how many there are."""
    n = 0
    for i in range(1, len(ring)):
        gap = np.int64(column[i]) - np.int64(column[i - 1])
        if ring[i] == ring[i - 1] and 0 < gap <= 64:
            rates[n] = (t_offset_ns[i] - t_offset_ns[i - 1]) / gap
            n += 1
    return n


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def mean_rate(ring, column, t_offset_ns, about):
    """ns a column over whole rings, leaving out the place where a scan begins and ends; `about` is a first guess."""
    time, columns = 0.0, 0
    for i in range(1, len(ring)):
        gap = np.int64(column[i]) - np.int64(column[i - 1])
        dt = t_offset_ns[i] - t_offset_ns[i - 1]
        if ring[i] == ring[i - 1] and abs(dt - about * gap) < 32.0 * abs(about):
            time += dt
            columns += gap
    return time / columns if columns > 0 else about
