"""The Image and Feature node written plainly, from the description of LIO-SAM: twins of the kernels."""

from __future__ import annotations

import math
from collections import defaultdict
from fractions import Fraction
from itertools import pairwise

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


def range_units(p: np.ndarray) -> int:
    """floor(1024 |p|) of the coordinates rounded to 2^-14 m, halves away from zero, in Python's integers."""
    x, y, z = (int(abs(Fraction(float(v))) * 2**14 + Fraction(1, 2)) for v in p)
    return min(max(math.isqrt((x * x + y * y + z * z) >> 8), 1), 2**18 - 1)


def rings_of(ring_start: np.ndarray) -> list[range]:
    return [range(int(a), int(b)) for a, b in pairwise(ring_start)]


def differences(range_q: np.ndarray, ring_start: np.ndarray) -> np.ndarray:
    out = np.zeros(len(range_q), int)
    for ring in rings_of(ring_start):
        r = range_q[ring.start : ring.stop].astype(int)
        for i in range(5, len(r) - 5):
            out[ring.start + i] = abs(r[i - 5 : i + 6].sum() - 11 * r[i])
    return out


def unreliable(range_q: np.ndarray, column: np.ndarray, ring_start: np.ndarray, occlusion: int) -> np.ndarray:
    marked = np.zeros(len(range_q), bool)
    for ring in rings_of(ring_start):
        r, c = (a[ring.start : ring.stop].astype(int) for a in (range_q, column))
        m = marked[ring.start : ring.stop]
        for i in range(5, len(r) - 6):
            if c[i + 1] - c[i] < 10:
                if r[i] - r[i + 1] > occlusion:
                    for l in range(6):
                        m[i - l] = True
                elif r[i + 1] - r[i] > occlusion:
                    for l in range(1, 7):
                        m[i + l] = True
            if abs(r[i - 1] - r[i]) > Fraction(r[i], 50) and abs(r[i + 1] - r[i]) > Fraction(r[i], 50):
                m[i] = True
    return marked


def sector_of(ring_start: np.ndarray, sectors: int) -> np.ndarray:
    out = np.full(int(ring_start[-1]), 7)
    for ring in rings_of(ring_start):
        start, end = ring.start + 5, ring.stop - 6
        for j in range(sectors):
            sp = (start * (sectors - j) + end * j) // sectors
            ep = (start * (sectors - 1 - j) + end * (j + 1)) // sectors - 1
            if end > start:
                out[sp : ep + 1] = j
    return out


def corner_ranks(
    d: np.ndarray, corner: np.ndarray, column: np.ndarray, ring_start: np.ndarray, sectors: int, largest: int
) -> np.ndarray:
    picked = np.zeros(len(d), bool)
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
            for i in [ep, *sorted(range(sp, ep), key=lambda k: (-int(d[k]), k))]:
                if picked[i] or not corner[i]:
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


def facing(points: np.ndarray, column: np.ndarray, ring_start: np.ndarray, keep: np.ndarray) -> dict[int, int]:
    groups, rings, c = {}, rings_of(ring_start), column.astype(int)
    for row, ring in enumerate(rings):
        outer = rings[row + 1] if row + 1 < len(rings) and len(rings[row + 1]) else rings[row - 1] if row else range(0)
        for i in ring:
            if not keep[i]:
                continue
            groups[i] = 10
            if i - 1 not in ring or i + 1 not in ring or not len(outer):
                continue
            j = max(outer, key=lambda k: (-abs(c[k] - c[i]), k))
            if abs(c[j] - c[i]) > 8:
                continue
            p = points.astype(np.float64)
            normal = np.cross(p[i + 1] - p[i - 1], p[j] - p[i])
            if np.linalg.norm(normal) < 1e-9:
                continue
            normal /= np.linalg.norm(normal)
            normal *= -1 if normal @ p[i] > 0 else 1
            if abs(normal[2]) > 0.7:
                groups[i] = 8 if normal[2] > 0 else 9
            else:
                groups[i] = int(math.atan2(normal[1], normal[0]) % (2 * math.pi) / (math.pi / 4)) % 8
    return groups


def shares(counts: np.ndarray, target: int) -> np.ndarray:
    """Points of each group, given one at a time to the group that has fewest of those that are not used up."""
    out = np.zeros(len(counts), int)
    for _ in range(min(target, int(counts.sum()))):
        open_groups = np.flatnonzero(out < counts)
        out[open_groups[np.argmin(out[open_groups])]] += 1
    return out
