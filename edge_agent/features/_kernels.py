"""Kernels of curvature and selection. Source of every formula: LIO-SAM, featureExtraction.cpp, as the
paper's Feature node runs it.

Where a loop has no way out of it and no index that may be negative, the processor takes many points at a time: so
rings are cut out first, and what is decided of a point is stored rather than branched on.
"""

from __future__ import annotations

import numpy as np
from numba import njit

FASTMATH = {"contract", "nsz"}
_CORNER, _FLAT = 2, 4  # edge_agent.features.integer
_EDGE = 5  # points at each end of a ring that have no whole window
_UNSHARP = np.int32(-1)


@njit(cache=True, nogil=True)
def differences(range_q, ring_start, d):
    """d[i] = |sum of the ten neighbours' ranges - 10 range[i]| (its square is LOAM's curvature); 0 near a ring's ends.

    range_q, d (M,) int32, 1/1024 m; ring_start (rings + 1,) int32.
    """
    for row in range(len(ring_start) - 1):
        ranges, out = range_q[ring_start[row] : ring_start[row + 1]], d[ring_start[row] : ring_start[row + 1]]
        out[:_EDGE] = 0
        out[max(len(out) - _EDGE, 0) :] = 0
        for i in range(len(out) - 2 * _EDGE):
            total = np.int32(0)
            for k in range(2 * _EDGE + 1):
                total = np.int32(total + ranges[i + k])
            out[i + _EDGE] = abs(np.int32(total - 11 * ranges[i + _EDGE]))


@njit(cache=True, nogil=True)
def longest_ring(ring_start):
    """How many points it has."""
    most = 0
    for row in range(len(ring_start) - 1):
        most = max(most, ring_start[row + 1] - ring_start[row])
    return most


@njit(cache=True, nogil=True)
def unreliable(range_q, column, ring_start, occlusion, marks):
    """marks[i] = 1 for points that may be occluded from elsewhere and for beams nearly parallel to the surface.

    Where the next point is nearer by more than `occlusion`, this one and the five before it are marked; where it is
    further away, the six after this one. Parallel: both neighbours' ranges differ by more than 2 % (50 times the
    difference is above the range).
    """
    begins = np.empty(longest_ring(ring_start) + _EDGE, np.uint8)
    for row in range(len(ring_start) - 1):
        start, end = np.int64(ring_start[row]), np.int64(ring_start[row + 1])
        mark_ring(range_q[start:end], column[start:end], occlusion, begins[: end - start + _EDGE], marks[start:end])


@njit(cache=True, nogil=True)
def mark_ring(ranges, column, occlusion, begins, marks):
    """`unreliable` for the n points of one ring. begins (n + 5,) uint8 scratch: [5 + i], do six marks end at i + 5?"""
    n, inner = len(ranges), len(ranges) - 2 * _EDGE - 1
    begins[:] = 0
    for i in range(inner):
        apart = np.int32(np.int32(column[i + 6]) - np.int32(column[i + 5]))
        begins[i + 5] = (apart < 10) & (np.int32(ranges[i + 5] - ranges[i + 6]) > occlusion)
    for i in range(inner):
        apart = np.int32(np.int32(column[i + 6]) - np.int32(column[i + 5]))
        begins[i + 11] |= (apart < 10) & (np.int32(ranges[i + 6] - ranges[i + 5]) > occlusion)
    for i in range(n):
        marks[i] = begins[i] | begins[i + 1] | begins[i + 2] | begins[i + 3] | begins[i + 4] | begins[i + 5]
    for i in range(inner):
        here = ranges[i + 5]
        before, after = abs(np.int32(ranges[i + 4] - here)), abs(np.int32(ranges[i + 6] - here))
        marks[i + 5] |= (np.int32(50 * before) > here) & (np.int32(50 * after) > here)


@njit(cache=True, nogil=True)
def candidates(d, ring_start, corner, flat, sectors, marks, sector):
    """Adds to marks (1: masked) 2 for d > corner and 4 for d < flat, where not masked and inside a sector (7: none).

    LIO-SAM cuts a ring's points from the 6th to the 7th last into equal sectors.
    """
    sector[:] = 7
    for row in range(len(ring_start) - 1):
        start = np.int64(ring_start[row]) + _EDGE
        length = np.int64(ring_start[row + 1]) - 6 - start
        if length <= 0 or sectors == 0:
            continue
        for j in range(sectors):
            sector[start + length * j // sectors : start + length * (j + 1) // sectors] = j
        ring_d, ring_marks = d[start : start + length], marks[start : start + length]
        for i in range(length):
            kind = np.uint8(_CORNER) if ring_d[i] > corner else np.uint8(_FLAT) if ring_d[i] < flat else np.uint8(0)
            ring_marks[i] = ring_marks[i] if ring_marks[i] else kind


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def corners_of_sector(d, marks, column, picked, span, largest, rank, scratch):
    """Corners of one sector, span = (sp, ep) inclusive: sharpest first, at most `largest`; returns their number.

    d, marks: see `differences` and `candidates`. picked: corners of the sectors before and their neighbours; those of
    this one are added. rank[i] = 1 + order of the corner in its sector, 0 elsewhere. As in LIO-SAM the last point of
    the sector is looked at first, whatever its curvature. scratch: two (ep - sp + 1,) int32, candidates and their d.
    """
    sp, ep = span
    who, sharpness = scratch
    found = count = 0
    if marks[ep] == _CORNER and picked[ep] == 0:
        found = 1
        rank[ep] = found
        suppress(column, picked, ep)
    for i in range(sp, ep):
        who[count], sharpness[count] = i, d[i]
        count += (marks[i] == _CORNER) & (picked[i] == 0)
    while found < largest:
        sharpest = _UNSHARP
        for k in range(count):
            sharpest = max(sharpest, sharpness[k])
        if sharpest == _UNSHARP:
            break
        k = 0
        while sharpness[k] != sharpest:
            k += 1
        found += 1
        rank[who[k]] = found
        suppress(column, picked, who[k])
        for near in range(max(k - 5, 0), min(k + 6, count)):
            if picked[who[near]] != 0:
                sharpness[near] = _UNSHARP
    return found


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def suppress(column, picked, i):
    """Marks a picked point and up to five neighbours each side, as far as the columns go on without a gap."""
    picked[i] = 1
    for l in range(1, 6):
        if i + l >= len(column) or abs(np.int64(column[i + l]) - np.int64(column[i + l - 1])) > 10:
            break
        picked[i + l] = 1
    for l in range(1, 6):
        if i - l < 0 or abs(np.int64(column[i - l]) - np.int64(column[i - l + 1])) > 10:
            break
        picked[i - l] = 1


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def select_corners(d, marks, column, picked, ring_start, sectors, largest, rank):
    """Corners of all rings and sectors among the candidates; fills rank (M,) and the scratch picked (M,) uint8.

    LIO-SAM begins each ring one point earlier, with a window that reaches into the ring before; here it does not.
    """
    rank[:] = 0
    picked[:] = 0
    total = 0
    room = longest_ring(ring_start) + 1
    scratch = np.empty(room, np.int32), np.empty(room, np.int32)
    for row in range(len(ring_start) - 1):
        start, end = np.int64(ring_start[row]) + _EDGE, np.int64(ring_start[row + 1]) - 6
        for j in range(sectors):
            sp = (start * (sectors - j) + end * j) // sectors
            ep = (start * (sectors - 1 - j) + end * (j + 1)) // sectors - 1
            if sp < ep:
                total += corners_of_sector(d, marks, column, picked, (sp, ep), largest, rank, scratch)
    return total


@njit(cache=True, nogil=True)
def indices(chosen, out):
    """out[:n], int32, = where chosen (N,) uint8 or uint16 is not 0; returns n."""
    n = 0
    for i in range(len(chosen)):
        out[n] = i
        n += chosen[i] != 0
    return n
