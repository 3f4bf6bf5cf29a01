"""The Image and Feature node written plainly, from the description of LIO-SAM: twins of the kernels."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from edge_agent.deskew.reference import lio_sam_column


def project(points: np.ndarray, ring: np.ndarray, rings: int, columns: int) -> tuple[dict, int, int]:
    cells: dict[tuple[int, int], int] = {}
    taken = outside = 0
    for i, p in enumerate(points.astype(np.float64)):
        cell = (int(ring[i]), lio_sam_column(p, columns))
        if ring[i] >= rings:
            outside += 1
        elif cell in cells:
            taken += 1
        else:
            cells[cell] = i
    return cells, taken, outside


def curvature(range_m: np.ndarray) -> np.ndarray:
    r = range_m.astype(np.float64)
    out = np.zeros(len(r))
    for i in range(5, len(r) - 5):
        out[i] = (r[i - 5 : i + 6].sum() - 11 * r[i]) ** 2
    return out


def unreliable(range_m: np.ndarray, column: np.ndarray) -> np.ndarray:
    r, c = range_m, column.astype(int)
    marked = np.zeros(len(r), bool)
    for i in range(5, len(r) - 6):
        if abs(c[i + 1] - c[i]) < 10:
            if r[i] - r[i + 1] > 0.3:
                for l in range(6):
                    marked[i - l] = True
            elif r[i + 1] - r[i] > 0.3:
                for l in range(1, 7):
                    marked[i + l] = True
        if abs(r[i - 1] - r[i]) > 0.02 * r[i] and abs(r[i + 1] - r[i]) > 0.02 * r[i]:
            marked[i] = True
    return marked


def corner_ranks(
    curvature_m2: np.ndarray,
    column: np.ndarray,
    marked: np.ndarray,
    ring_start: np.ndarray,
    sectors: int,
    threshold: float,
    largest: int,
) -> np.ndarray:
    picked = marked.copy()
    c = column.astype(int)
    rank = np.zeros(len(c), int)
    for row in range(len(ring_start) - 1):
        start, end = int(ring_start[row]) + 5, int(ring_start[row + 1]) - 6
        for j in range(sectors):
            sp = (start * (sectors - j) + end * j) // sectors
            ep = (start * (sectors - 1 - j) + end * (j + 1)) // sectors - 1
            if sp >= ep:
                continue
            found = 0
            for i in [ep, *sorted(range(sp, ep), key=lambda k: (-curvature_m2[k], k))]:
                if picked[i] or curvature_m2[i] <= threshold:
                    continue
                found += 1
                if found > largest:
                    break
                rank[i] = found
                picked[i] = True
                for step in (1, -1):
                    for l in range(1, 6):
                        k = i + step * l
                        if not 0 <= k < len(c) or abs(c[k] - c[k - step]) > 10:
                            break
                        picked[k] = True
    return rank


def thin(points: np.ndarray, rank: np.ndarray, ring_start: np.ndarray, leaf_m: float) -> np.ndarray:
    kept = np.zeros(len(points), bool)
    for row in range(len(ring_start) - 1):
        voxels: dict[tuple[int, ...], list[int]] = defaultdict(list)
        for i in range(int(ring_start[row]) + 5, int(ring_start[row + 1]) - 6):
            if rank[i] == 0:
                voxels[tuple(np.floor(points[i].astype(np.float64) * (1.0 / leaf_m)).astype(int))].append(i)
        for members in voxels.values():
            p = points[members].astype(np.float64)
            kept[members[int(np.argmin(((p - p.mean(axis=0)) ** 2).sum(axis=1)))]] = True
    return kept
