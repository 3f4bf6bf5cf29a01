"""What the views say of a part of the grid: how often each cell was hit, how often seen through."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.export.grid._grid_kernels import HIT, MISS, mark_hits, trace_rays
from splitslam.export.grid.ground import Ground
from splitslam.export.grid.settings import GridSettings
from splitslam.export.grid.spool import View

Array = NDArray[np.float64]
UNKNOWN, FREE, OCCUPIED = 0, 1, 2

# Evidence of a hit and of a miss, log odds (Hornung et al., "OctoMap", Autonomous Robots 2013, section 5.1).
_HIT, _MISS = 0.85, -0.4
_LAYER_M = 0.3  # a ray over a bush says nothing of the bush: heights are told apart
_BELOW_M = -0.5  # under the ground as it is known: its own unevenness
_CLEAR_CELLS = 1.5  # so far before the surface that it hits, measured across it, a ray says nothing
_FLATTEST = 0.05  # cosine of the incidence
_NEIGHBOUR = 0.06  # of the range: points of one surface in one ring are nearer to each other
_NEIGHBOUR_M = 0.6
_BETWEEN_CELLS = 2.0  # between rays at their ends
_DIRECTIONS = 720
_NOISE_SHARE = 0.1  # of the hits of a cell two away: what range noise leaves behind a surface
_SURROUNDED = 5  # free cells of eight: beams of 3 mrad are wider than their line, from 17 m on wider than a cell
_HALO = 2  # cells around a part that its own are compared with


class Evidence:
    """Counts for the cells of one part. corner (2,): of its cell (0, 0), m; shape: rows (y) and columns (x)."""

    def __init__(self, corner: Array, shape: tuple[int, int], ground: Ground, settings: GridSettings) -> None:
        cell_m = settings.resolution_m
        self._settings, self._ground = settings, ground
        corner = corner - _HALO * cell_m
        shape = (shape[0] + 2 * _HALO, shape[1] + 2 * _HALO)
        standing_m = settings.max_height_m - settings.min_height_m
        layers = max(1, round(standing_m / _LAYER_M))
        self._frame = np.array([*corner, cell_m, _BELOW_M, settings.min_height_m, standing_m / layers])
        self._heights = ground.patch(corner, cell_m, shape)
        self._marks = np.full((2, 1 + layers, *shape), -1, np.int32)
        self._counts = np.zeros((2, 1 + layers, *shape), np.uint16)

    def add(self, view: View) -> None:
        """One more view."""
        s = self._settings
        standing, over_m = self._standing(view.points)
        level = view.points[:, :2] - view.sensor[:2]
        range_m = np.hypot(level[:, 0], level[:, 1])
        hits = standing & (range_m <= s.range_m)
        points = np.column_stack([view.points[hits, :2], over_m[hits]])
        mark_hits(points, self._frame, self._marks, self._counts, view.number)
        margin_m = np.where(standing, self._margin_m(view, level, range_m), 0.0)
        ends, margin_m = with_those_between(view, standing, margin_m, _BETWEEN_CELLS * s.resolution_m)
        range_m = np.maximum(np.hypot(*(ends[:, :2] - view.sensor[:2]).T), 1e-6)
        stops = np.clip(np.minimum(1.0 - margin_m / range_m, s.range_m / range_m), 0.0, 1.0)
        trace_rays(view.sensor, ends, stops, self._frame, self._heights, self._marks, self._counts, view.number)

    def _standing(self, points: Array) -> tuple[NDArray[np.bool_], Array]:
        """(N,) which of points (N, 3) stand on the ground rather than being it, and how high over it they are, m."""
        over_m = points[:, 2] - self._ground.at(points[:, :2])
        return over_m >= self._settings.min_height_m + self._ground.doubt_m(points[:, :2]), over_m

    def _margin_m(self, view: View, level: Array, range_m: Array) -> Array:
        """(N,) how far before its end a ray runs within a cell or so of the surface that it hits.

        A ray that grazes a wall runs along it for metres, in the wall's own cells. The wall's direction is that of the
        neighbours in the ring; without them it is taken to stand across.
        """
        steps = np.where(neighbours(view)[:, None], np.diff(view.points[:, :2], axis=0), 0.0)
        nothing = np.zeros((1, 2))
        along = np.concatenate([steps, nothing]) + np.concatenate([nothing, steps])
        length = np.linalg.norm(along, axis=1)
        cross = np.abs(level[:, 0] * along[:, 1] - level[:, 1] * along[:, 0])
        cosine = np.where(length > 0, cross / np.maximum(length * range_m, 1e-9), 1.0)
        return _CLEAR_CELLS * self._settings.resolution_m / np.maximum(cosine, _FLATTEST)

    def states(self) -> NDArray[np.uint8]:
        """(R, C): OCCUPIED where something stands in any layer, FREE where nothing does and the lowest two, the ground
        or what is just above the lowest obstacles, were seen through; UNKNOWN else.
        """
        odds = _HIT * self._counts[HIT].astype(np.float32) + _MISS * self._counts[MISS].astype(np.float32)
        hits = self._counts[HIT].sum(axis=0, dtype=np.float64)
        stands = (odds[1:] > 0.0).any(axis=0) & (hits >= _NOISE_SHARE * _strongest_near(hits))
        state = np.where((odds[:2] < 0.0).any(axis=0), FREE, UNKNOWN).astype(np.uint8)
        state[stands] = OCCUPIED
        state[(state == UNKNOWN) & (_around(state == FREE) >= _SURROUNDED) & (_around(stands) == 0)] = FREE
        return state[_HALO:-_HALO, _HALO:-_HALO]


def neighbours(view: View) -> NDArray[np.bool_]:
    """(N - 1,) whether each point and the next one are of one surface in one ring."""
    range_m = np.linalg.norm(view.points - view.sensor, axis=1)
    apart_m = np.linalg.norm(np.diff(view.points, axis=0), axis=1)
    return apart_m < np.maximum(_NEIGHBOUR * np.minimum(range_m[1:], range_m[:-1]), _NEIGHBOUR_M)


def with_those_between(
    view: View, standing: NDArray[np.bool_], margin_m: Array, spacing_m: float
) -> tuple[Array, Array]:
    """The points of a view and those between neighbours on the ground, `spacing_m` apart: ends (M, 3), margins (M,), m.

    The edge has thinned the returns of a smooth surface to one in 0.4 m; the beams between them went the same way.
    Not where something stands in the same direction and nearer: it may have caught them.
    """
    first = np.flatnonzero(neighbours(view) & ~standing[1:] & ~standing[:-1])
    steps = view.points[first + 1] - view.points[first]
    count = np.maximum(np.ceil(np.linalg.norm(steps, axis=1) / spacing_m).astype(np.int64) - 1, 0)
    which = np.repeat(np.arange(len(first)), count)
    share = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + 1.0) / (count[which] + 1.0)
    between = view.points[first[which]] + share[:, None] * steps[which]
    bins, range_m = _directions(view.points[standing], view.sensor)
    nearest_m = np.full(_DIRECTIONS, np.inf)
    np.minimum.at(nearest_m, bins, range_m)
    nearest_m = np.minimum(nearest_m, np.minimum(np.roll(nearest_m, 1), np.roll(nearest_m, -1)))
    bins, range_m = _directions(between, view.sensor)
    between = between[range_m < nearest_m[bins]]
    return np.concatenate([view.points, between]), np.concatenate([margin_m, np.zeros(len(between))])


def _directions(points: Array, sensor: Array) -> tuple[NDArray[np.int64], Array]:
    """Direction (N,) 0 to _DIRECTIONS - 1 and distance (N,), m, of points in the plane."""
    x, y = (points[:, :2] - sensor[:2]).T
    turn = np.arctan2(y, x) / (2 * np.pi) + 0.5
    return np.minimum((turn * _DIRECTIONS).astype(np.int64), _DIRECTIONS - 1), np.hypot(x, y)


def _around(cells: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(R, C): how many of the eight around each are set."""
    padded = np.pad(cells, 1).astype(np.int64)
    rows, cols = cells.shape
    around = sum(padded[i : i + rows, j : j + cols] for i in range(3) for j in range(3))
    return around - padded[1:-1, 1:-1]


def _strongest_near(hits: Array) -> Array:
    """(R, C): most hits of a cell and those up to two cells away."""
    padded = np.pad(hits, _HALO)
    columns = np.max([padded[:, k : k + hits.shape[1]] for k in range(2 * _HALO + 1)], axis=0)
    return np.max([columns[k : k + hits.shape[0]] for k in range(2 * _HALO + 1)], axis=0)
