"""Where the ground is: a height for each cell of a coarse grid, from the points and from where the robot went."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from splitslam.export.grid._grid_kernels import grow_ground
from splitslam.export.grid.spool import View, ViewSpool

Array = NDArray[np.float64]
_CELL_M = 1.0
_STEP_M = 0.35  # between neighbouring cells: a slope of 20 degrees
_BELOW_M, _ABOVE_M = 0.1, 0.3  # about the lowest point: what is ground, a slope within the cell included
_NEAR_M = (1.0, 8.0)  # from the sensor: where the ground's height below it is taken
_MOST_CELLS = 4_000_000
_DOUBT_M, _DOUBT_CELLS = 0.1, 4  # for each cell beyond the ground that was seen; up to so many


class Ground:
    """Heights (R, C) in `map`, m, at the middles of cells; between them bilinear."""

    def __init__(self, spool: ViewSpool) -> None:
        """Two passes over the views: the lowest points, then the mean of what lies near the ground grown from them."""
        extent = np.maximum(spool.high - spool.low, _CELL_M)
        self._cell_m = max(_CELL_M, float(np.sqrt(extent.prod() / _MOST_CELLS)))
        self._low = spool.low
        self._shape = tuple((np.ceil(extent / self._cell_m).astype(int) + 1).tolist()[::-1])
        lowest = self._lowest(spool)
        self.heights = self._grown(lowest, spool.sensors, self._sensor_height_m(spool, lowest))
        self._refine(spool)

    def at(self, xy: Array) -> Array:
        """Heights (N,) at points (N, 2), m; beyond the grid as at its edge."""
        at = (xy - self._low) / self._cell_m - 0.5
        return _bilinear(self.heights, at[:, 1], at[:, 0])

    def doubt_m(self, xy: Array) -> Array:
        """By how much the height at points (N, 2) may be wrong, (N,) m: 0 where points lie on the ground itself."""
        return self._doubt_m[self._cells(xy)]

    def patch(self, corner: Array, cell_m: float, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Heights (R, C) at the middles of a grid's cells; corner (2,): its low one."""
        rows, cols = (
            (corner[axis] + (np.arange(size) + 0.5) * cell_m - self._low[axis]) / self._cell_m - 0.5
            for axis, size in ((1, shape[0]), (0, shape[1]))
        )
        return _bilinear(self.heights, rows[:, None], cols[None, :]).astype(np.float32)

    def _cells(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        cells = np.floor((points[:, :2] - self._low) / self._cell_m).astype(np.int64)
        return np.clip(cells[:, 1], 0, self._shape[0] - 1), np.clip(cells[:, 0], 0, self._shape[1] - 1)

    def _inside(self, view: View) -> Array:
        """The points of a view that lie in the grid."""
        top = self._low + np.array(self._shape[::-1]) * self._cell_m
        return view.points[((view.points[:, :2] >= self._low) & (view.points[:, :2] < top)).all(axis=1)]

    def _lowest(self, spool: ViewSpool) -> Array:
        lowest = np.full(self._shape, np.inf)
        for view in spool.views():
            points = self._inside(view)
            np.minimum.at(lowest, self._cells(points), points[:, 2])
        return lowest

    def _sensor_height_m(self, spool: ViewSpool, lowest: Array) -> float:
        """How high the sensor is carried: over the lowest points of the cells around, the middle of all keyframes."""
        heights = [self._height_over(sensor, lowest) for sensor in spool.sensors]
        known = [height for height in heights if np.isfinite(height)]
        return float(np.median(known)) if known else 0.0

    def _height_over(self, sensor: Array, lowest: Array) -> float:
        reach = int(np.ceil(_NEAR_M[1] / self._cell_m))
        (r,), (c,) = self._cells(sensor[None])
        around = lowest[max(r - reach, 0) : r + reach + 1, max(c - reach, 0) : c + reach + 1]
        seen = around[np.isfinite(around)]
        return float(sensor[2] - np.median(seen)) if len(seen) else np.nan

    def _grown(self, lowest: Array, sensors: Array, sensor_height_m: float) -> Array:
        ground = np.full(self._shape, np.nan)
        ground[self._cells(sensors)] = sensors[:, 2] - sensor_height_m
        queue = np.empty((ground.size, 2), np.int64)
        seeds = np.argwhere(~np.isnan(ground))
        queue[: len(seeds)] = seeds
        grow_ground(lowest, ground, np.zeros(self._shape, np.int16), queue, len(seeds), _STEP_M * self._cell_m)
        return ground

    def _refine(self, spool: ViewSpool) -> None:
        total, count = np.zeros(self._shape), np.zeros(self._shape)
        for points in self._near_ground(spool):
            cells = self._cells(points)
            np.add.at(total, cells, points[:, 2])
            np.add.at(count, cells, 1.0)
        known = count > 0
        self.heights = _filled(np.divide(total, count, out=self.heights.copy(), where=known), known)
        self._doubt_m = _doubt_m(known)

    def _near_ground(self, spool: ViewSpool) -> Iterator[Array]:
        for view in spool.views():
            points = self._inside(view)
            over_m = points[:, 2] - self.heights[self._cells(points)]
            yield points[(over_m >= -_BELOW_M) & (over_m <= _ABOVE_M)]


def _filled(heights: Array, known: NDArray[np.bool_]) -> Array:
    """What is not known, smoothly between what is: from coarser and coarser means (pull), finer ones first (push).

    Gortler et al., "The Lumigraph", SIGGRAPH 1996, section 3.4.
    """
    if known.all() or min(heights.shape) < 2:
        return heights if known.any() else np.full_like(heights, np.mean(heights))
    rows, cols = heights.shape
    pad = ((0, rows % 2), (0, cols % 2))
    weight = np.pad(known.astype(np.float64), pad)
    total = np.pad(np.where(known, heights, 0.0), pad)
    halves = (weight.shape[0] // 2, 2, weight.shape[1] // 2, 2)
    weight, total = weight.reshape(halves).sum(axis=(1, 3)), total.reshape(halves).sum(axis=(1, 3))
    coarse = _filled(np.divide(total, weight, out=np.zeros_like(total), where=weight > 0), weight > 0)
    row, col = (np.arange(rows) - 0.5) / 2.0, (np.arange(cols) - 0.5) / 2.0
    return np.where(known, heights, _bilinear(coarse, row[:, None], col[None, :]))


def _doubt_m(known: NDArray[np.bool_]) -> Array:
    """(R, C): more with each cell to the next one whose ground was seen."""
    doubt_m = np.zeros(known.shape)
    for _ in range(_DOUBT_CELLS):
        doubt_m[~known] += _DOUBT_M
        padded = np.pad(known, 1)
        known = known | padded[2:, 1:-1] | padded[:-2, 1:-1] | padded[1:-1, 2:] | padded[1:-1, :-2]
    return doubt_m


def _bilinear(heights: Array, row: Array, col: Array) -> Array:
    """Values at fractional indices that broadcast against each other; beyond the edge as there."""
    row, col = np.clip(row, 0, heights.shape[0] - 1), np.clip(col, 0, heights.shape[1] - 1)
    i, j = np.floor(row).astype(np.int64), np.floor(col).astype(np.int64)
    i1, j1 = np.minimum(i + 1, heights.shape[0] - 1), np.minimum(j + 1, heights.shape[1] - 1)
    u, v = row - i, col - j
    low = heights[i, j] * (1 - v) + heights[i, j1] * v
    high = heights[i1, j] * (1 - v) + heights[i1, j1] * v
    return low * (1 - u) + high * u
