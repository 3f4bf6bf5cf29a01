"""Kernels that choose among a frame's features when it does not carry all of them. They work on lists of features."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from edge_agent.features.integer import FLAT

FASTMATH = {"contract", "nsz"}
_UNKNOWN = 10  # which way it faces
_BESIDE = 8  # columns: a point of the next ring further away says nothing of this one


@njit(cache=True, nogil=True)
def sharpest(rank, target, chosen):
    """chosen[i] = 1 for `target` corners: the first of every sector, then the second of each, until there are enough.

    rank (K,): see corners_of_sector. Of the rank that does not fit as a whole, an even share. Returns how many.
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
        total += np.int64(chosen[i])  # without the JIT it were of 8 bits
    return total


@njit(cache=True, nogil=True)
def pick(index, chosen, kept):
    """kept[:n] = index (K,) where chosen (K,) is not 0; returns n."""
    n = 0
    for i in range(len(index)):
        kept[n] = index[i]
        n += chosen[i] != 0
    return n


@njit(cache=True, nogil=True)
def sharpest_of(rank, corners, target, kept):
    """kept[:n] = `target` of corners (K,), see `sharpest`; rank (N,) is that of every point. Returns n."""
    ranks, chosen = np.empty(len(corners), np.int64), np.empty(len(corners), np.uint8)
    for k in range(len(corners)):
        ranks[k] = rank[corners[k]]
    sharpest(ranks, target, chosen)
    return pick(corners, chosen, kept)


@njit(cache=True, nogil=True)
def spread(target, chosen):
    """chosen[i] = 1 for `target` of K features, evenly spaced in order (all, if there are fewer). Returns how many."""
    wanted, carry = min(target, len(chosen)), 0
    for i in range(len(chosen)):
        carry += wanted
        chosen[i] = carry >= len(chosen)
        carry -= len(chosen) if chosen[i] else 0
    return wanted


@njit(cache=True, nogil=True)
def nearest_column(column, first, last, wanted):
    """Index in [first, last) of the column nearest to the wanted one, the later of two; column rises there."""
    low, high = first, min(first + max(wanted - np.int64(column[first]), 0), last - 1)  # by one at least for each
    if column[high] <= wanted:
        low = high
    while high - low > 1:
        middle = (low + high) // 2
        if column[middle] <= wanted:
            low = middle
        else:
            high = middle
    if low + 1 < last and abs(np.int64(column[low + 1]) - wanted) <= abs(np.int64(column[low]) - wanted):
        low += 1
    return low


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def facing(points, column, ring_start, index, group):
    """group[k] of each point index[k], rising: which way its surface faces; 0..7 walls by azimuth, 8 floor, 9 ceiling.

    10 where it cannot be said. The normal is that of the plane through the point's neighbours in its ring and the
    point nearest in column of the next ring outwards (the one before for the last ring). Frame `lidar`.
    """
    rings, k = len(ring_start) - 1, 0
    for row in range(rings):
        start, end = np.int64(ring_start[row]), np.int64(ring_start[row + 1])
        other = row + 1 if row + 1 < rings and ring_start[row + 2] > end else row - 1
        first, last = np.int64(0), np.int64(0)
        if other >= 0:
            first, last = np.int64(ring_start[other]), np.int64(ring_start[other + 1])
        while k < len(index) and index[k] < end:
            i = np.int64(index[k])
            group[k] = _UNKNOWN
            if i - 1 >= start and i + 1 < end and first < last:
                first = nearest_column(column, first, last, np.int64(column[i]))
                if abs(np.int64(column[first]) - np.int64(column[i])) <= _BESIDE:
                    group[k] = facing_of(points, i, first)
            k += 1


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def facing_of(points, i, beside):
    """`facing` of point i, whose neighbour in the other ring is `beside`."""
    ax, ay, az = (
        points[i + 1, 0] - points[i - 1, 0],
        points[i + 1, 1] - points[i - 1, 1],
        points[i + 1, 2] - points[i - 1, 2],
    )
    bx, by, bz = points[beside, 0] - points[i, 0], points[beside, 1] - points[i, 1], points[beside, 2] - points[i, 2]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-9:
        return _UNKNOWN
    if x * points[i, 0] + y * points[i, 1] + z * points[i, 2] > 0.0:  # towards the sensor it shall point
        x, y, z = -x, -y, -z
    if abs(z) > 0.7 * length:
        return 8 if z > 0.0 else 9
    quarter = 0
    while quarter < 3 and not (x > 0.0 and y >= 0.0):
        x, y, quarter = y, -x, quarter + 1
    return 2 * quarter + (1 if y >= x else 0)


@njit(cache=True, nogil=True)
def spread_by_group(group, target, chosen):
    """`spread`, but `target` is divided evenly among the groups (0..10) first; what small ones lack goes to others."""
    counts, quotas, carry = np.zeros(11, np.int64), np.zeros(11, np.int64), np.zeros(11, np.int64)
    for i in range(len(group)):
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
    for i in range(len(group)):
        g = group[i]
        carry[g] += quotas[g]
        chosen[i] = carry[g] >= counts[g]
        carry[g] -= counts[g] if chosen[i] else 0
        total += np.int64(chosen[i])  # without the JIT it were of 8 bits
    return total


@njit(cache=True, nogil=True)
def spread_of(index, target, kept):
    """kept[:n] = `target` of index (K,), see `spread`. Returns n."""
    chosen = np.empty(len(index), np.uint8)
    spread(target, chosen)
    return pick(index, chosen, kept)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def facing_all_ways(points, column, ring_start, surfs, marks, target, kept):
    """kept[:n] = `target` of surfs (K,): flat and reliable ones, evenly by which way they face; rougher ones only when
    there are too few. Returns n.

    Rusinkiewicz, Levoy, "Efficient variants of the ICP algorithm", 2001, section 3.1: normal-space sampling.
    """
    flat, flats = np.empty(len(surfs), np.int32), 0
    for k in range(len(surfs)):
        flat[flats] = surfs[k]
        flats += marks[surfs[k]] == FLAT
    group, chosen = np.empty(flats, np.uint8), np.empty(len(surfs), np.uint8)
    facing(points, column, ring_start, flat[:flats], group)
    taken = spread_by_group(group, target, chosen[:flats])
    if taken >= target:
        return pick(flat[:flats], chosen, kept)
    spread(target - taken, chosen[flats:])
    flats = n = 0
    for k in range(len(surfs)):  # both are in the order of surfs
        kept[n] = surfs[k]
        if marks[surfs[k]] == FLAT:
            n += chosen[flats] != 0
            flats += 1
        else:
            n += chosen[len(group) + k - flats] != 0
    return n


@njit(cache=True, nogil=True)
def take(image, index, features):
    """Copies points index (K,) of an image into features, rows of both as in FeatureSet.

    image: points_lidar, column, source of edge_agent.features.projection.Image, and ring, t_offset_ns, intensity of
    its scan.
    """
    points, column, source, ring, t_offset_ns, intensity = image
    to_points, to_ring, to_column, to_times, to_intensity = features
    for k in range(len(index)):
        i = index[k]
        at = source[i]
        to_points[k, 0], to_points[k, 1], to_points[k, 2] = points[i, 0], points[i, 1], points[i, 2]
        to_ring[k], to_column[k], to_times[k], to_intensity[k] = ring[at], column[i], t_offset_ns[at], intensity[at]
