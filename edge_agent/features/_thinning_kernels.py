"""Kernels that thin surfs: LIO-SAM's voxel filter, ring by ring, but with a real point for each voxel."""

from __future__ import annotations

import numpy as np
from numba import njit

FASTMATH = {"contract", "nsz"}
_VOXEL_BITS = 18
_VOXELS = (1 << _VOXEL_BITS) - 1
_CORNER = -1  # in place of a key
X, Y, Z, COUNT, BEST, DISTANCE = range(6)  # columns of sums


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def thin_surfs(points, rank, ring_start, leaf_m, table, sums, kept):
    """Per ring and voxel the point nearest to the centroid of the voxel's surf points (all that are no corner).

    table (S, 2) int64, S a power of two >= twice the points of a ring: key and voxel of each slot, of the ring at hand
    or of one before. sums (V, 6) float64, V the points of a ring, see `sum_voxels`. kept (N,) int32: indices of the
    points that stay, rising. Returns how many.
    """
    table[:, 0] = -1
    keys, runs = np.empty(len(sums), np.int64), np.empty((len(sums) + 1, 2), np.int32)
    stays = np.zeros(len(sums), np.uint8)
    total = 0
    for row in range(len(ring_start) - 1):
        first, last = np.int64(ring_start[row]) + 5, np.int64(ring_start[row + 1]) - 6
        n = last - first
        if n <= 0:
            continue
        voxel_keys(points[first:last], rank[first:last], row, 1.0 / leaf_m, keys)
        count, voxels = sum_voxels(points[first:last], keys, row, table, sums, runs)
        nearest_to_centroids(points[first:last], keys, runs[: count + 1], sums)
        for v in range(voxels):
            stays[np.int64(sums[v, BEST])] = 1
        for i in range(n):
            kept[total] = first + i
            total += stays[i]
            stays[i] = 0
    return total


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def voxel_keys(points, rank, row, inverse, keys):
    """keys[i], one number for ring and voxel: 8 and three times 18 bits, which reach 52 km at 0.4 m; -1 for corners."""
    for i in range(len(points)):
        ix = np.int64(np.int32(np.floor(points[i, 0] * inverse))) & _VOXELS
        iy = np.int64(np.int32(np.floor(points[i, 1] * inverse))) & _VOXELS
        iz = np.int64(np.int32(np.floor(points[i, 2] * inverse))) & _VOXELS
        key = (np.int64(row) << 54) | (ix << 36) | (iy << 18) | iz
        keys[i] = key if rank[i] == 0 else _CORNER


@njit(cache=True, nogil=True)
def slot_of(table, key, row):
    """Where the key is in the table, or where there is room for it: no other key of this ring is there."""
    mask = len(table) - 1
    ix, iy, iz = (key >> 36) & _VOXELS, (key >> 18) & _VOXELS, key & _VOXELS
    slot = (ix * 73856093 ^ iy * 19349669 ^ iz * 83492791) & mask
    while table[slot, 0] != key and table[slot, 0] >> 54 == row:
        slot = (slot + 1) & mask
    return slot


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def sum_voxels(points, keys, row, table, sums, runs):
    """Adds a ring's points up by voxel: x y z count; BEST -1. Returns how many runs and voxels there are.

    Neighbours mostly share a voxel. runs (R + 1, 2) int32: first point and voxel of each such run, corners in it
    included; then the end of the last one.
    """
    before, count, voxels, voxel = np.int64(_CORNER), 0, 0, np.int64(0)
    x = y = z = n = 0.0
    for i in range(len(points)):
        key = keys[i]
        if key != before:
            if key == _CORNER:
                continue
            if count > 0:
                sums[voxel, X], sums[voxel, Y], sums[voxel, Z], sums[voxel, COUNT] = x, y, z, n
            before, slot = key, slot_of(table, key, row)
            if table[slot, 0] != key:
                table[slot, 0], table[slot, 1] = key, voxels
                sums[voxels, :] = 0.0
                sums[voxels, BEST] = -1.0
                voxels += 1
            voxel = table[slot, 1]
            x, y, z, n = sums[voxel, X], sums[voxel, Y], sums[voxel, Z], sums[voxel, COUNT]
            runs[count, 0], runs[count, 1] = i, voxel
            count += 1
        x += points[i, 0]
        y += points[i, 1]
        z += points[i, 2]
        n += 1.0
    if count > 0:
        sums[voxel, X], sums[voxel, Y], sums[voxel, Z], sums[voxel, COUNT] = x, y, z, n
    runs[count, 0] = len(points)
    return count, voxels


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def nearest_to_centroids(points, keys, runs, sums):
    """BEST and DISTANCE (squared) of each voxel: its point nearest to the centroid, the first of equals."""
    for r in range(len(runs) - 1):
        voxel = np.int64(runs[r, 1])
        n = sums[voxel, COUNT]
        x, y, z = sums[voxel, X] / n, sums[voxel, Y] / n, sums[voxel, Z] / n
        best, least = sums[voxel, BEST], sums[voxel, DISTANCE]
        for i in range(runs[r, 0], runs[r + 1, 0]):
            dx, dy, dz = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
            d2 = dx * dx + dy * dy + dz * dz
            if keys[i] != _CORNER and (best < 0.0 or d2 < least):
                best, least = float(i), d2
        sums[voxel, BEST], sums[voxel, DISTANCE] = best, least
