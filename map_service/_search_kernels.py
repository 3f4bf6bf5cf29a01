"""Kernel of the wide search; table layout and matching are those of `_kernels.py`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam.registration._kernels import FASTMATH, KIND, PLANE, pack, slot_of


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def closeness(slots, geometry, points_lidar, poses, voxel_m, levels, gate_m, scores):
    """Adds to scores (C,) how close points (N, 3) lie to the map's fits from each of the poses (C, 4, 4).

    A point counts 1 - (d / gate)^2 for its distance d to the plane or line of the finest voxel around it that has one,
    and nothing beyond the gate: the score of MSAC, Torr and Zisserman, "MLESAC", 2000, section 3.
    """
    for c in range(len(poses)):
        T = poses[c]
        total = 0.0
        for k in range(len(points_lidar)):
            px, py, pz = points_lidar[k, 0], points_lidar[k, 1], points_lidar[k, 2]
            x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
            y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
            z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
            size = voxel_m
            for level in range(levels):
                ix, iy, iz = math.floor(x / size), math.floor(y / size), math.floor(z / size)
                i = slot_of(slots, pack(level, np.int64(ix), np.int64(iy), np.int64(iz)))
                row = slots[i, 1]
                size *= 2.0
                if slots[i, 0] == -1 or geometry[row, KIND] == 0.0:
                    continue
                g = geometry[row]
                dx, dy, dz = x - g[0], y - g[1], z - g[2]
                along = dx * g[3] + dy * g[4] + dz * g[5]
                square = along * along
                if g[KIND] != PLANE:
                    square = dx * dx + dy * dy + dz * dz - square
                total += max(0.0, 1.0 - square / (gate_m * gate_m))
                break
        scores[c] += total
