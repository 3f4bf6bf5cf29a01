"""Kernels of the driver: motion into the table's fixed point, a scan into a packet, an answer into an image."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam._motion_kernels import rotation_from_vector, vector_between

FASTMATH = {"contract", "nsz"}
UNIFORM = 2.1  # knots that are even need no more than twice the even segment: whole parts of an interval


@njit(cache=True, nogil=True)
def parts_of(offsets_ns, last_ns, segment_ns):
    """How many segments of at most segment_ns all knot intervals between 0 and last_ns make."""
    total = 0
    for k in range(len(offsets_ns) - 1):
        span = min(offsets_ns[k + 1], last_ns) - max(offsets_ns[k], 0)
        if span > 0:
            total += (span + segment_ns - 1) // segment_ns
    return total


@njit(cache=True, nogil=True)
def lay_breaks(offsets_ns, last_ns, segment_ns, breaks_ns):
    """Cuts the time from the first knot (or 0) to last_ns; returns how many breaks, the end of the last one included.

    Every knot interval into equal parts of at most segment_ns; of a little more, if breaks_ns is too short for that;
    where that would make some far longer than others can be, all even, whatever the knots.
    """
    most = len(breaks_ns) - 1
    first_ns = max(offsets_ns[0], 0)
    even_ns = max((last_ns - first_ns + most - 1) // most, 1)
    if parts_of(offsets_ns, last_ns, segment_ns) > most:
        low, high = segment_ns, max(np.int64(UNIFORM * even_ns), segment_ns + 1)
        if parts_of(offsets_ns, last_ns, high) > most:
            for s in range(most + 1):
                breaks_ns[s] = first_ns + (last_ns - first_ns) * s // most
            return most + 1
        while high - low > 1000:
            middle = (low + high) // 2
            if parts_of(offsets_ns, last_ns, middle) > most:
                low = middle
            else:
                high = middle
        segment_ns = high
    count = 0
    breaks_ns[0] = first_ns
    for k in range(len(offsets_ns) - 1):
        start = max(offsets_ns[k], 0)
        span = min(offsets_ns[k + 1], last_ns) - start
        if span > 0:
            parts = (span + segment_ns - 1) // segment_ns
            for part in range(1, parts + 1):
                count += 1
                breaks_ns[count] = start + span * part // parts
    return count + 1


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def fill_table(offsets_ns, rotation, translation_m, breaks_ns, shift, scale, table):
    """The words of the segments between breaks, each on its tick; the last one holds. False: motion out of range.

    table (S, 28) int32, breaks_ns (S,) int64, a tick is 2^shift ns. scale (12,) float64: units per entry of the 3x4
    base; a slope is 2^-20 of that, per tick. The pose at a break is slerp and linear between the knots around it.
    """
    A, B, D, w = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    here, there = np.empty(12), np.empty(12)
    fits = True
    half = (1 << shift) >> 1
    knots = len(offsets_ns)
    k = -1
    for s in range(len(breaks_ns)):
        tick = (breaks_ns[s] + half) >> shift
        t = min(max(tick << shift, offsets_ns[0]), offsets_ns[knots - 1])
        if k < 0 or (k < knots - 2 and t >= offsets_ns[k + 1]):
            k = max(k, 0)
            while k < knots - 2 and t >= offsets_ns[k + 1]:
                k += 1
            rotation_from_vector(rotation[k, 0], rotation[k, 1], rotation[k, 2], A)
            rotation_from_vector(rotation[k + 1, 0], rotation[k + 1, 1], rotation[k + 1, 2], B)
            vector_between(A, B, w)
        f = (t - offsets_ns[k]) / (offsets_ns[k + 1] - offsets_ns[k])
        rotation_from_vector(f * w[0], f * w[1], f * w[2], D)
        for r in range(3):
            for c in range(3):
                there[4 * r + c] = (A[r, 0] * D[0, c] + A[r, 1] * D[1, c] + A[r, 2] * D[2, c]) * scale[4 * r + c]
            there[4 * r + 3] = ((1.0 - f) * translation_m[k, r] + f * translation_m[k + 1, r]) * scale[4 * r + 3]
        if s > 0:
            ticks = tick - table[s - 1, 0]
            per_tick = 1048576.0 / ticks if ticks > 0 else 0.0
            for e in range(12):
                slope = math.floor((there[e] - here[e]) * per_tick + 0.5)
                fits = fits and abs(slope) < 2147483648.0
                table[s - 1, 16 + e] = np.int64(slope) if fits else 0
        table[s, 0], table[s, 1], table[s, 2], table[s, 3] = tick, 0, 0, 0
        for e in range(12):
            base = math.floor(there[e] + 0.5)
            fits = fits and abs(base) < 67108864.0
            table[s, 4 + e] = np.int64(base) if fits else 0
            table[s, 16 + e] = 0
            here[e] = there[e]
    return fits


@njit(cache=True, nogil=True)
def pack_points(points, t_offset_ns, ring, shift, beats):
    """beats (N, 4) uint32 of points (N, 3), the bits of float32: the tick is the nearest one, within 24 bits."""
    half = (1 << shift) >> 1
    for i in range(len(points)):
        tick = (max(np.int64(t_offset_ns[i]), 0) + half) >> shift
        beats[i, 0], beats[i, 1], beats[i, 2] = points[i, 0], points[i, 1], points[i, 2]
        beats[i, 3] = (np.int64(ring[i]) << 24) | min(tick, 0xFFFFFF)


@njit(cache=True, nogil=True)
def count_flags(beats, counts):
    """counts (2,): points flagged unusable, points whose ring is outside (and usable). beats: (N, 4) uint32."""
    counts[:] = 0
    for i in range(len(beats)):
        flags = np.int64(beats[i, 2]) >> 4 & 15
        if flags & 2:
            counts[0] += 1
        elif flags & 4:
            counts[1] += 1


@njit(cache=True, nogil=True)
def order_points(beats, cells, records):
    """The records of an answer that has none: index, column and ring; the first point of a cell wins.

    beats (N, 4) uint32; cells (rings, columns) int32 scratch; records (>= points of the image,) uint64. Returns how
    many, -1 if a point claims a cell outside.
    """
    rings, columns = cells.shape
    cells[:] = -1
    for i in range(len(beats)):
        z = np.int64(beats[i, 2])
        if z >> 4 & 1:
            row = np.int64(beats[i, 0]) & 255
            column = (z & 15) << 8 | (np.int64(beats[i, 1]) & 255)
            if row >= rings or column >= columns:
                return -1
            if cells[row, column] < 0:
                cells[row, column] = i
    n = 0
    for row in range(rings):
        for column in range(columns):
            i = cells[row, column]
            if i >= 0:
                records[n] = np.uint64(i | column << 18 | row << 29)
                n += 1
    return n


@njit(cache=True, nogil=True)
def unpack_image(beats, records, columns, points, ring, column, source, ring_start):
    """Points (M, 3) float32 in m, ring, column and index of M records; ring_start (rings + 1,). False: not an answer.

    beats (N, 4) uint32 are the points as the logic sends them. A record must point at a valid point of its own cell,
    and the cells must rise.
    """
    rings = len(ring_start) - 1
    row, before = -1, -1
    for j in range(len(records)):
        record = np.int64(records[j])
        i, cell_column, cell_row = record & 0x3FFFF, record >> 18 & 0x7FF, record >> 29 & 0x7F
        cell = cell_row * 2048 + cell_column
        if i >= len(beats) or cell_row >= rings or cell_column >= columns or cell <= before:
            return False
        x, y, z = np.int64(beats[i, 0]), np.int64(beats[i, 1]), np.int64(beats[i, 2])
        if x & 255 != cell_row or (z & 15) << 8 | y & 255 != cell_column or z >> 4 & 1 == 0:
            return False
        before = cell
        while row < cell_row:
            row += 1
            ring_start[row] = j
        points[j, 0] = ((x >> 8 ^ 0x800000) - 0x800000) * 6.103515625e-05
        points[j, 1] = ((y >> 8 ^ 0x800000) - 0x800000) * 6.103515625e-05
        points[j, 2] = ((z >> 8 ^ 0x800000) - 0x800000) * 6.103515625e-05
        ring[j], column[j], source[j] = cell_row, cell_column, i
    while row < rings:
        row += 1
        ring_start[row] = len(records)
    return True


@njit(cache=True, nogil=True)
def unpack_marks(records, d, marks, sector):
    """d (M,) int32, marks and sector (M,) uint8 of M records; see edge_agent.features.integer.FeatureMarks."""
    for j in range(len(records)):
        record = records[j]
        d[j] = np.int64(record >> np.uint64(36)) & 0x3FFFFF
        sector[j] = np.int64(record >> np.uint64(58)) & 7
        marks[j] = np.int64(record >> np.uint64(61))


@njit(cache=True, nogil=True)
def gather_ranges(beats, source, range_q):
    """range_q (M,) int32 in 1/1024 m of the points of an image, source (M,) being their indices."""
    for j in range(len(source)):
        range_q[j] = beats[source[j], 3]
