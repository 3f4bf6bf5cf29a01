"""Kernels between two sets of features and one, by ring and column. Rows of `points` are those of _point_kernels."""

from __future__ import annotations

import numpy as np
from numba import njit

from splitslam.codec._point_kernels import CLASS, COLUMN, INTENSITY

FASTMATH = {"contract", "nsz"}

SHADE = 17  # of 256, to a step of the intensity
MERGED, UNSORTED, OUTSIDE = range(3)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def merge(corners, surfs, columns, counts, points, points_lidar, t_offset_ns):
    """Two sets of features as one by ring and column, corners first where they share a cell.

    corners, surfs: (points_lidar, ring, column, t_offset_ns, intensity), as in FeatureSet, A and B of them. Fills
    counts (rings,), rows CLASS, COLUMN and INTENSITY of points, points_lidar (A + B, 3), t_offset_ns (A + B,). Returns
    UNSORTED or OUTSIDE (of the rings or columns) instead of MERGED for features that break their contract.
    """
    na, nb, rings = len(corners[1]), len(surfs[1]), len(counts)
    counts[:] = 0
    a, b, previous = 0, 0, np.int64(-1)
    key_a = _cell(corners, a)
    key_b = _cell(surfs, b)
    for n in range(na + nb):
        key, is_corner = min(key_a, key_b), key_a <= key_b
        ring, column = key >> 16, key & 65535
        if key < previous:
            return UNSORTED
        if ring >= rings or column >= columns:
            return OUTSIDE
        previous = key
        counts[ring] += 1
        points[CLASS, n], points[COLUMN, n] = is_corner, column
        if is_corner:
            _copy(corners, a, n, points, points_lidar, t_offset_ns)
            a += 1
            key_a = _cell(corners, a)
        else:
            _copy(surfs, b, n, points, points_lidar, t_offset_ns)
            b += 1
            key_b = _cell(surfs, b)
    return MERGED


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _cell(features, i):
    _, ring, column, _, _ = features
    return (np.int64(ring[i]) << 16) + np.int64(column[i]) if i < len(ring) else np.int64(1 << 40)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _copy(features, i, n, points, points_lidar, t_offset_ns):
    from_points, _, _, from_times, intensity = features
    points[INTENSITY, n] = (np.int64(intensity[i]) + SHADE // 2) // SHADE
    t_offset_ns[n] = from_times[i]
    for k in range(3):
        points_lidar[n, k] = from_points[i, k]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def part(points, counts, points_lidar, t_offset_ns, corners, surfs):
    """The inverse of merge: fills both sets, whose sizes are those of rows CLASS."""
    a, b, n = 0, 0, 0
    for ring in range(len(counts)):
        for _ in range(counts[ring]):
            if points[CLASS, n]:
                _place(corners, a, n, ring, points, points_lidar, t_offset_ns)
                a += 1
            else:
                _place(surfs, b, n, ring, points, points_lidar, t_offset_ns)
                b += 1
            n += 1


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _place(features, i, n, ring, points, points_lidar, t_offset_ns):
    to_points, rings, columns, times, intensity = features
    rings[i], columns[i], times[i] = ring, points[COLUMN, n], t_offset_ns[n]
    intensity[i] = points[INTENSITY, n] * SHADE
    for k in range(3):
        to_points[i, k] = points_lidar[n, k]
