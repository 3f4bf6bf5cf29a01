"""Kernel of the place descriptor."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

FASTMATH = {"contract", "arcp", "nsz"}


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def polar_heights(points, centre, ring_m, floor_m, ceiling_m, heights):
    """heights (R, S) = highest point of each ring and sector around `centre` (2,), above floor_m, at most ceiling_m.

    points (N, 3), z up; an empty cell is 0. Kim and Kim, "Scan Context", IROS 2018, equations 1 to 4.
    """
    rings, sectors = heights.shape
    heights[:] = 0.0
    for k in range(len(points)):
        x, y = points[k, 0] - centre[0], points[k, 1] - centre[1]
        ring = np.int64(math.sqrt(x * x + y * y) / ring_m)
        if ring >= rings:
            continue
        sector = np.int64((math.atan2(y, x) / (2.0 * math.pi) + 0.5) * sectors) % sectors
        height = min(max(points[k, 2] - floor_m, 0.0), ceiling_m)
        if height > heights[ring, sector]:
            heights[ring, sector] = height
