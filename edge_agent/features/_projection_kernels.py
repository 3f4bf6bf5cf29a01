"""Kernels of the range image. Source of every formula: LIO-SAM, imageProjection.cpp, as the paper's Image node runs it.

Where the programmable logic does the same, whole numbers make it the same to the bit.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

FASTMATH = {"contract", "nsz"}
ARCTANGENTS = np.array([round(math.atan(2.0**-i) / (2.0 * math.pi) * 2.0**27) for i in range(22)])  # of 2^-27 turns
BLOCK = 256
QUICK_NEAR_RAD = np.float32(4e-6)
STEPS, NEAREST_STEPS, FURTHEST_STEPS = np.float32(1 << 14), np.float32(1 << 12), np.float32(1 << 22)  # 0.25 to 256 m
ZERO, HALF, ONE, HALF_PI, PI = (np.float32(v) for v in (0.0, 0.5, 1.0, 0.5 * math.pi, math.pi))
A2, A4, A6, A8 = (np.float32(v) for v in (-0.3333314528, 0.1999355085, -0.1420889944, 0.1065626393))
A10, A12, A14, A16 = (np.float32(v) for v in (-0.0752896400, 0.0429096138, -0.0161657367, 0.0028662257))


@njit(cache=True, nogil=True)
def to_steps(v):
    """A coordinate in steps of 2^-14 m, halves rounded away from zero: what the programmable logic sees."""
    whole = np.floor(abs(np.float64(v)) * 16384.0 + 0.5)
    return whole if v >= 0.0 else -whole


@njit(cache=True, nogil=True)
def cordic_azimuth(x, y):
    """Angle of (x, y), whole steps below 2^23, in 2^-27 turns: to the bit what the logic's CORDIC finds."""
    largest = max(abs(x), abs(y))
    if largest == 0:
        return np.int64(0)
    while largest < 1 << 22:
        largest, x, y = largest << 1, x << 1, y << 1
    angle = np.int64(1 << 26 if x < 0 else 0)
    u, v = abs(x) << 2, (-y if x < 0 else y) << 2
    for i in range(22):
        down = v >> 63  # all ones below the axis: (a ^ down) - down is -a there; nobody could guess a branch
        u, v = u + ((v >> i ^ down) - down), v - ((u >> i ^ down) - down)
        angle += (ARCTANGENTS[i] ^ down) - down
    return ((angle + (1 << 26)) & ((1 << 27) - 1)) - (1 << 26)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def column_of(x, y, columns):
    """The column of a point, by LIO-SAM: -round((atan2(x, y) - 90 deg) / resolution) + columns / 2.

    The angle in it is minus the azimuth. x, y in m. Within 512 m as the logic has it, which is to the bit.
    """
    a, b = to_steps(x), to_steps(y)
    if abs(a) < 8388608.0 and abs(b) < 8388608.0:
        angle = cordic_azimuth(np.int64(a), np.int64(b)) * columns
        whole = (abs(angle) + (1 << 26)) >> 27
        column = columns // 2 + (whole if angle >= 0 else -whole)
    else:
        v = math.atan2(b, a) * columns / (2.0 * math.pi)
        whole = np.int64(abs(v) + 0.5)
        column = columns // 2 + (whole if v >= 0.0 else -whole)
    if column < 0:  # of an odd number of columns
        column += columns
    return column - columns if column >= columns else column


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def quick_columns(x, y, columns, out):
    """column_of, eight points at a time; -1 where float32 cannot tell: near a column's edge, the axis or far away.

    x, y, out (N,) float32, float32, int32. Arctangent: Abramowitz, Stegun, "Handbook of mathematical functions",
    1964, 4.4.49 (2e-8); with float32 below 1e-6.
    """
    per_rad, near = np.float32(columns / (2.0 * math.pi)), QUICK_NEAR_RAD * np.float32(columns / (2.0 * math.pi))
    middle, turn = np.int32(columns // 2), np.int32(columns)
    for i in range(len(out)):
        a, b = np.floor(abs(x[i]) * STEPS + HALF), np.floor(abs(y[i]) * STEPS + HALF)
        steep = b > a
        high, low = b if steep else a, a if steep else b
        t = low / (high if high > ONE else ONE)
        s = t * t
        angle = t * (ONE + s * (A2 + s * (A4 + s * (A6 + s * (A8 + s * (A10 + s * (A12 + s * (A14 + s * A16))))))))
        angle = HALF_PI - angle if steep else angle
        angle = PI - angle if x[i] < ZERO else angle
        edge = angle * per_rad + HALF
        sure = (high >= NEAREST_STEPS) & (high < FURTHEST_STEPS) & (abs(edge - np.floor(edge + HALF)) > near)
        whole = np.int32(edge)
        column = middle + (whole if y[i] >= ZERO else -whole)
        column = column + turn if column < 0 else column
        column = column - turn if column >= turn else column
        out[i] = column if sure else np.int32(-1)


@njit(cache=True, nogil=True)
def known_points(ring, rings):
    """How many points have a ring below `rings`."""
    count = 0
    for i in range(len(ring)):
        count += ring[i] < rings
    return count


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def project(points, ring, cells, ranges, counts):
    """cells (rings, columns) int32: index of the first point of each cell, -1 where there is none.

    ranges (N,) int32, 1/1024 m. counts (2,) int64: points dropped because the cell was taken, because the ring does not
    exist.
    """
    rings, columns = cells.shape
    cells[:] = -1
    counts[:] = 0
    room, found = np.empty((3, BLOCK), np.float32), np.empty(BLOCK, np.int32)
    for start in range(0, len(points), BLOCK):
        block = points[start : start + BLOCK]
        x, y, z = room[0, : len(block)], room[1, : len(block)], room[2, : len(block)]
        for k in range(len(block)):  # side by side, so that wide registers can take them
            x[k], y[k], z[k] = block[k, 0], block[k, 1], block[k, 2]
        quick_columns(x, y, columns, found[: len(block)])
        range_units(x, y, z, ranges[start : start + BLOCK])
        for k in range(len(block)):
            row = ring[start + k]
            if row >= rings:
                counts[1] += 1
                continue
            column = np.int64(found[k])
            if column < 0:
                column = column_of(x[k], y[k], columns)
            if cells[row, column] >= 0:
                counts[0] += 1
            else:
                cells[row, column] = start + k


@njit(cache=True, nogil=True)
def range_units(x, y, z, ranges):
    """ranges (N,) int32, 1 to 2^18 - 1: in 1/1024 m, rounded down, of coordinates (N,) first rounded to 2^-14 m.

    In whole numbers throughout (float64 holds them all exactly), so that the programmable logic finds the same.
    """
    for k in range(len(ranges)):
        a = np.floor(abs(np.float64(x[k])) * 16384.0 + 0.5)
        b = np.floor(abs(np.float64(y[k])) * 16384.0 + 0.5)
        c = np.floor(abs(np.float64(z[k])) * 16384.0 + 0.5)
        units = math.sqrt(np.floor((a * a + b * b + c * c) / 256.0))
        ranges[k] = np.int32(min(max(units, 1.0), 262143.0))


@njit(cache=True, nogil=True)
def gather(cells, points, ranges, out_points, out_range, out_column, source, ring_start):
    """Lays the cells' points out by ring, then column; ring_start (rings + 1,). Returns how many there are.

    points (N, 3) float32, as seen or moved; ranges (N,) of `project`. Outputs have room for all cells; source int32 is
    each point's index in the scan.
    """
    rings, columns = cells.shape
    n = 0
    for row in range(rings):
        ring_start[row] = first = n
        line = cells[row]
        for column in range(columns):
            source[n], out_column[n] = line[column], column  # to stay only if there is a point
            n += line[column] >= 0
        for k in range(first, n):
            i = np.uint32(source[k])
            out_points[k, 0], out_points[k, 1], out_points[k, 2] = points[i, 0], points[i, 1], points[i, 2]
            out_range[k] = ranges[i]
    ring_start[rings] = n
    return n
