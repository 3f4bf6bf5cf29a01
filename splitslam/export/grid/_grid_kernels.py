"""Kernels of the occupancy grid: ground that grows from the robot's way, hits, and rays through cells."""

from __future__ import annotations

import math

from numba import njit

FASTMATH = {"contract", "arcp", "nsz"}
HIT, MISS = 0, 1
FULL = 65_535
MOST_GAPS = 5


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def grow_ground(lowest, ground, gaps, queue, filled, step_m):
    """Spreads ground (R, C) from the cells that have a height to all others (NaN), the nearest first.

    A cell takes its lowest point (R, C), inf where there is none, when that is within step_m of the height it was
    reached from, for each cell of the way since the last one that had such a point; else that height: what stands
    there has no ground to show. gaps: (R, C) int16, 0, filled with that way, MOST_GAPS at most. queue: (R * C, 2)
    int64, its first `filled` rows the cells that have a height.
    """
    rows, cols = ground.shape
    head, tail = 0, filled
    while head < tail:
        r, c = queue[head, 0], queue[head, 1]
        head += 1
        for k in range(4):
            i = r + (k == 0) - (k == 1)
            j = c + (k == 2) - (k == 3)
            if i < 0 or i >= rows or j < 0 or j >= cols or not math.isnan(ground[i, j]):
                continue
            ground[i, j] = ground[r, c]
            gaps[i, j] = min(gaps[r, c] + 1, MOST_GAPS)
            if abs(lowest[i, j] - ground[r, c]) <= step_m * gaps[i, j]:
                ground[i, j] = lowest[i, j]
                gaps[i, j] = 0
            queue[tail, 0], queue[tail, 1] = i, j
            tail += 1


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def layer_of(height, frame, layers):
    """The layer of a height over ground, m, -1 outside; 0 is what the robot rolls over, the others are equal."""
    if height < frame[4]:
        return 0 if height >= frame[3] else -1
    layer = 1 + math.floor((height - frame[4]) / frame[5])
    return layer if layer < layers else -1


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def mark_hits(points, frame, marks, counts, stamp):
    """Counts a hit for each cell and layer that one of points (N, 3) lies in, once a view.

    points: x, y, height over ground. frame: x and y of the low corner, side of a cell; heights over ground at which
    layers 0 and 1 begin, height of a layer. marks (2, L, R, C) int32: the last view that hit and that passed a cell;
    counts (2, L, R, C) uint16: how many have. stamp: number of this view.
    """
    layers, rows, cols = marks.shape[1:]
    for k in range(len(points)):
        i = math.floor((points[k, 1] - frame[1]) / frame[2])
        j = math.floor((points[k, 0] - frame[0]) / frame[2])
        layer = layer_of(points[k, 2], frame, layers)
        if 0 <= i < rows and 0 <= j < cols and layer >= 0 and marks[HIT, layer, i, j] != stamp:
            marks[HIT, layer, i, j] = stamp
            counts[HIT, layer, i, j] = min(int(counts[HIT, layer, i, j]) + 1, FULL)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def trace_rays(sensor, ends, frame, ground, marks, counts, stamp):
    """Counts a miss for each cell that a ray from the sensor passes, in the layer that it passes it in, once a view,
    unless it was hit there.

    ends (N, 3), m: of what counts of each ray; ground (R, C): its height. frame, marks, counts: as
    in mark_hits. Cell by cell as Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics
    1987, from where a ray enters the grid.
    """
    layers, rows, cols = marks.shape[1:]
    x, y = (sensor[0] - frame[0]) / frame[2], (sensor[1] - frame[1]) / frame[2]
    for k in range(len(ends)):
        dx, dy = (ends[k, 0] - sensor[0]) / frame[2], (ends[k, 1] - sensor[1]) / frame[2]
        start, stop = 0.0, 1.0
        for at, along, size in ((x, dx, cols), (y, dy, rows)):
            if along != 0.0:
                first, last = -at / along, (size - at) / along
                start, stop = max(start, min(first, last)), min(stop, max(first, last))
            elif at < 0.0 or at >= size:
                stop = -1.0
        if start >= stop:
            continue
        j = min(max(math.floor(x + start * dx), 0), cols - 1)
        i = min(max(math.floor(y + start * dy), 0), rows - 1)
        next_x = (j + (dx > 0.0) - x) / dx if dx != 0.0 else math.inf
        next_y = (i + (dy > 0.0) - y) / dy if dy != 0.0 else math.inf
        at = start
        while at < stop and 0 <= i < rows and 0 <= j < cols:
            leaves = min(next_x, next_y, stop)
            height = sensor[2] + 0.5 * (at + leaves) * (ends[k, 2] - sensor[2]) - ground[i, j]
            layer = layer_of(height, frame, layers)
            if layer >= 0 and marks[HIT, layer, i, j] != stamp and marks[MISS, layer, i, j] != stamp:
                marks[MISS, layer, i, j] = stamp
                counts[MISS, layer, i, j] = min(int(counts[MISS, layer, i, j]) + 1, FULL)
            at = leaves
            if next_x <= next_y:
                j += 1 if dx > 0.0 else -1
                next_x += abs(1.0 / dx) if dx != 0.0 else math.inf
            else:
                i += 1 if dy > 0.0 else -1
                next_y += abs(1.0 / dy) if dy != 0.0 else math.inf
