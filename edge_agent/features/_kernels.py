"""Kernels of curvature and selection. Source of every formula: LIO-SAM, featureExtraction.cpp, as the
paper's Feature node runs it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

FASTMATH = {"contract", "nsz"}


@njit(cache=True, nogil=True)
def differences(range_q, ring_start, d):
    """d[i] = |sum of the ten neighbours' ranges - 10 range[i]| (its square is LOAM's curvature); 0 near a ring's ends.

    range_q, d (M,) int32, 1/1024 m; ring_start (rings + 1,) int32.
    """
    for row in range(len(ring_start) - 1):
        start, end = np.int64(ring_start[row]), np.int64(ring_start[row + 1])
        d[start : min(start + 5, end)] = 0
        d[max(end - 5, start) : end] = 0
        for i in range(start + 5, end - 5):
            total = range_q[i - 5] + range_q[i - 4] + range_q[i - 3] + range_q[i - 2] + range_q[i - 1]
            total += range_q[i + 1] + range_q[i + 2] + range_q[i + 3] + range_q[i + 4] + range_q[i + 5]
            d[i] = abs(total - 10 * range_q[i])


@njit(cache=True, nogil=True)
def unreliable(range_q, column, ring_start, occlusion, marks):
    """marks[i] = 1 for points that may be occluded from elsewhere and for beams nearly parallel to the surface.

    Parallel: both neighbours' ranges differ by more than 2 % (50 times the difference is above the range).
    """
    marks[:] = 0
    for row in range(len(ring_start) - 1):
        for i in range(np.int64(ring_start[row]) + 5, np.int64(ring_start[row + 1]) - 6):
            before, here, after = np.int64(range_q[i - 1]), np.int64(range_q[i]), np.int64(range_q[i + 1])
            if np.int64(column[i + 1]) - np.int64(column[i]) < 10:
                if here - after > occlusion:
                    marks[i - 5 : i + 1] = 1
                elif after - here > occlusion:
                    marks[i + 1 : i + 7] = 1
            if 50 * abs(before - here) > here and 50 * abs(after - here) > here:
                marks[i] = 1


@njit(cache=True, nogil=True)
def candidates(d, ring_start, corner, flat, sectors, marks, sector):
    """Adds to marks (1: masked) 2 for d > corner and 4 for d < flat, where not masked and inside a sector (7: none).

    LIO-SAM cuts a ring's points from the 6th to the 7th last into equal sectors.
    """
    sector[:] = 7
    for row in range(len(ring_start) - 1):
        start = np.int64(ring_start[row]) + 5
        length = np.int64(ring_start[row + 1]) - 6 - start
        for j in range(sectors):
            for i in range(start + length * j // sectors, start + length * (j + 1) // sectors):
                sector[i] = j
                if marks[i] == 0:
                    if d[i] > corner:
                        marks[i] = 2
                    elif d[i] < flat:
                        marks[i] = 4


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def corners_of_sector(d, marks, column, picked, span, largest, rank):
    """Corners of one sector, span = (sp, ep) inclusive: sharpest first, at most `largest`; returns their number.

    d, marks: see `differences` and `candidates`. picked: corners of the sectors before and their neighbours; those of
    this one are added. rank[i] = 1 + order of the corner in its sector, 0 elsewhere. As in LIO-SAM the last point of
    the sector is looked at first, whatever its curvature.
    """
    sp, ep = span
    count = 0
    for i in range(sp, ep):
        if marks[i] == 2 and picked[i] == 0:
            count += 1
    order = np.empty(count + 1, np.int64)
    keys = np.empty(count, np.int32)
    count = 0
    for i in range(sp, ep):
        if marks[i] == 2 and picked[i] == 0:
            order[count + 1] = i
            keys[count] = -d[i]
            count += 1
    order[1:] = order[1:][np.argsort(keys, kind="mergesort")]
    order[0] = ep
    found = 0
    for i in order:
        if picked[i] != 0 or marks[i] != 2:
            continue
        found += 1
        if found > largest:
            return largest
        rank[i] = found
        suppress(column, picked, i)
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
    for row in range(len(ring_start) - 1):
        start, end = ring_start[row] + 5, ring_start[row + 1] - 6
        for j in range(sectors):
            sp = (start * (sectors - j) + end * j) // sectors
            ep = (start * (sectors - 1 - j) + end * (j + 1)) // sectors - 1
            if sp < ep:
                total += corners_of_sector(d, marks, column, picked, (sp, ep), largest, rank)
    return total


@njit(cache=True, nogil=True)
def voxel_key(row, ix, iy, iz):
    """One number for ring and voxel: 8 and three times 18 bits, which reach 52 km at 0.4 m."""
    return (np.int64(row) << 54) | ((ix & 0x3FFFF) << 36) | ((iy & 0x3FFFF) << 18) | (iz & 0x3FFFF)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def thin_surfs(points, rank, ring_start, leaf_m, table, sums, voxel_of, kept):
    """Per ring and voxel the point nearest to the centroid of the voxel's surf points (all that are no corner).

    table (S, 2) int64, S a power of two >= twice the points of a ring: key and voxel of each slot, of the ring at hand
    or of one before. sums (V, 6) float64, V the points of a ring: x y z count of each voxel, 1 + index of its best
    point so far and that one's squared distance. voxel_of (N,) int32 scratch. kept (N,) uint8: 1 for the points that
    stay. Returns how many.
    """
    kept[:] = 0
    table[:, 0] = -1
    mask = len(table) - 1
    inverse = 1.0 / leaf_m
    total = 0
    for row in range(len(ring_start) - 1):
        start, end = ring_start[row] + 5, ring_start[row + 1] - 6
        before, voxel, voxels = np.int64(-1), np.int64(0), np.int64(0)
        for i in range(start, end):
            if rank[i] > 0:
                continue
            ix = np.int64(math.floor(points[i, 0] * inverse))
            iy = np.int64(math.floor(points[i, 1] * inverse))
            iz = np.int64(math.floor(points[i, 2] * inverse))
            key = voxel_key(row, ix, iy, iz)
            if key != before:  # neighbours mostly share a voxel
                before, slot = key, (ix * 73856093 ^ iy * 19349669 ^ iz * 83492791) & mask
                while table[slot, 0] != key and table[slot, 0] >> 54 == row:
                    slot = (slot + 1) & mask
                if table[slot, 0] != key:
                    table[slot, 0], table[slot, 1] = key, voxels
                    sums[voxels, :] = 0.0
                    voxels += 1
                voxel = table[slot, 1]
            sums[voxel, 0] += points[i, 0]
            sums[voxel, 1] += points[i, 1]
            sums[voxel, 2] += points[i, 2]
            sums[voxel, 3] += 1.0
            voxel_of[i] = voxel
        nearest_to_centroids(points, rank, (start, end), sums, voxel_of, kept)
        total += voxels
    return total


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def nearest_to_centroids(points, rank, span, sums, voxel_of, kept):
    """Second half of thin_surfs for one ring."""
    at, x, y, z = np.int64(-1), 0.0, 0.0, 0.0
    for i in range(span[0], span[1]):
        if rank[i] > 0:
            continue
        s = np.int64(voxel_of[i])
        if s != at:
            at, x, y, z = s, sums[s, 0] / sums[s, 3], sums[s, 1] / sums[s, 3], sums[s, 2] / sums[s, 3]
        dx, dy, dz = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
        d2 = dx * dx + dy * dy + dz * dz
        best = np.int64(sums[s, 4]) - 1
        if best < 0 or d2 < sums[s, 5]:
            if best >= 0:
                kept[best] = 0
            kept[i] = 1
            sums[s, 4], sums[s, 5] = i + 1.0, d2


@njit(cache=True, nogil=True)
def sharpest(rank, target, chosen):
    """chosen[i] = 1 for `target` corners: the first of every sector, then the second of each, until there are enough.

    rank (N,): see corners_of_sector. Of the rank that does not fit as a whole, an even share. Returns how many.
    """
    counts = np.zeros(np.int64(rank.max()) + 2 if len(rank) else 2, np.int64)
    for i in range(len(rank)):
        counts[rank[i]] += 1
    last, left = 1, np.int64(target)
    while last < len(counts) and counts[last] <= left:
        left -= counts[last]
        last += 1
    share, carry, total = left if last < len(counts) else np.int64(0), np.int64(0), 0
    for i in range(len(rank)):
        chosen[i] = 0 < rank[i] < last
        if rank[i] == last:
            carry += share
            if carry >= counts[last]:
                carry -= counts[last]
                chosen[i] = 1
        total += chosen[i]
    return total


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def spread(keep, target, chosen):
    """chosen[i] = 1 for `target` of the points with keep[i] = 1, evenly spaced in order (all, if there are fewer)."""
    n = 0
    for i in range(len(keep)):
        n += 1 if keep[i] else 0
    wanted = min(target, n)
    carry = 0
    for i in range(len(keep)):
        chosen[i] = 0
        if keep[i]:
            carry += wanted
            if carry >= n:
                carry -= n
                chosen[i] = 1
    return wanted


@njit(cache=True, nogil=True)
def pick(keep, marks, mark, equal, out):
    """out[i] = 1 for the points with keep[i] = 1 whose mark is `mark`, or with equal = False is not. All (N,) uint8."""
    for i in range(len(keep)):
        out[i] = keep[i] & ((marks[i] == mark) == equal)


@njit(cache=True, nogil=True)
def indices(chosen, out):
    """out[:n], int32, = where chosen (N,) uint8 or uint16 is not 0; returns n."""
    n = 0
    for i in range(len(chosen)):
        out[n] = i
        n += chosen[i] != 0
    return n


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def facing(points, column, ring_start, keep, group):
    """group[i] of each point with keep[i] = 1: which way its surface faces; 0..7 walls by azimuth, 8 floor, 9 ceiling.

    10 where it cannot be said. The normal is that of the plane through the point's neighbours in its ring and the
    point nearest in column of the next ring outwards (the one before for the last ring). Frame `lidar`.
    """
    rings = len(ring_start) - 1
    for row in range(rings):
        start, end = np.int64(ring_start[row]), np.int64(ring_start[row + 1])
        other = row + 1 if row + 1 < rings and ring_start[row + 2] > end else row - 1
        first, last = 0, 0
        if other >= 0:
            first, last = np.int64(ring_start[other]), np.int64(ring_start[other + 1])
        j = first
        for i in range(start, end):
            if keep[i] == 0:
                continue
            group[i] = 10
            if i - 1 < start or i + 1 >= end or first >= last:
                continue
            c = np.int64(column[i])
            while j + 1 < last and abs(np.int64(column[j + 1]) - c) <= abs(np.int64(column[j]) - c):
                j += 1
            if abs(np.int64(column[j]) - c) > 8:
                continue
            ax, ay, az = (
                points[i + 1, 0] - points[i - 1, 0],
                points[i + 1, 1] - points[i - 1, 1],
                points[i + 1, 2] - points[i - 1, 2],
            )
            bx, by, bz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            length = math.sqrt(nx * nx + ny * ny + nz * nz)
            if length < 1e-9:
                continue
            towards = nx * points[i, 0] + ny * points[i, 1] + nz * points[i, 2]
            sign = -1.0 / length if towards > 0.0 else 1.0 / length
            nx, ny, nz = nx * sign, ny * sign, nz * sign
            if nz > 0.7:
                group[i] = 8
            elif nz < -0.7:
                group[i] = 9
            else:
                group[i] = np.int64((math.atan2(ny, nx) / (2.0 * math.pi) + 1.0) * 8.0) & 7


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def spread_by_group(keep, group, target, chosen):
    """`spread`, but `target` is divided evenly among the groups (0..10) first; what small ones lack goes to others."""
    counts, quotas, carry = np.zeros(11, np.int64), np.zeros(11, np.int64), np.zeros(11, np.int64)
    for i in range(len(keep)):
        if keep[i]:
            counts[group[i]] += 1
    left, open_groups = np.int64(target), np.count_nonzero(counts)
    for _ in range(11):
        smallest = -1
        for g in range(11):
            if counts[g] > 0 and quotas[g] == 0 and (smallest < 0 or counts[g] < counts[smallest]):
                smallest = g
        if smallest < 0 or left <= 0:
            break
        quotas[smallest] = min(counts[smallest], -(-left // open_groups))
        left -= quotas[smallest]
        open_groups -= 1
    total = 0
    for i in range(len(keep)):
        chosen[i] = 0
        if keep[i]:
            g = group[i]
            carry[g] += quotas[g]
            if carry[g] >= counts[g]:
                carry[g] -= counts[g]
                chosen[i] = 1
                total += 1
    return total
