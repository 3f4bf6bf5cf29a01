"""Kernels of the driver: a scan into a packet, an answer into an image."""

from __future__ import annotations

import numpy as np
from numba import njit


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

    beats (N, 4) uint32 are the points as the logic sends them. A record must point at a point of its own ring and
    column (their lower bytes, which lie in one word), and the cells must rise. A loop for each thing and no way out of
    one: so each of them is vectorised.
    """
    count, rings = len(beats), len(ring_start) - 1
    wrong, before = False, np.int64(-1)
    for j in range(len(records)):
        record = np.int64(records[j] & np.uint64(0xFFFFFFFFF))
        cell = record >> 18
        i, cell_column, cell_row = record & 0x3FFFF, cell & 0x7FF, cell >> 11
        wrong |= (i >= count) | (cell_row >= rings) | (cell_column >= columns) | (cell <= before)
        before = cell
        ring[j], column[j], source[j] = cell_row, cell_column, i
    if wrong:
        return False
    halves, bits = beats.view(np.uint64), np.uint64(0)  # x and y, z and range
    for j in range(len(records)):
        xy = halves[np.uint32(records[j] & np.uint64(0x3FFFF)), 0]
        own = (xy & np.uint64(255)) << np.uint64(11) | xy >> np.uint64(32) & np.uint64(255)
        bits |= own ^ records[j] >> np.uint64(18) & np.uint64(0x3F8FF)
    if bits:
        return False
    step = np.float32(2.0**-14)
    for j in range(len(records)):
        i = np.uint32(source[j])
        points[j, 0] = np.float32(np.int32(beats[i, 0]) >> 8) * step
        points[j, 1] = np.float32(np.int32(beats[i, 1]) >> 8) * step
        points[j, 2] = np.float32(np.int32(beats[i, 2]) >> 8) * step
    low = 0
    for row in range(rings + 1):  # the rings rise: where each begins
        high = len(records)
        while low < high:
            middle = (low + high) // 2
            if ring[middle] < row:
                low = middle + 1
            else:
                high = middle
        ring_start[row] = low
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
