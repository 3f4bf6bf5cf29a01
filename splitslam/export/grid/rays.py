"""What each view says of a grid, worked out once, and on disk for the parts of the grid that are made one by one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitslam.export.grid.ground import Ground
from splitslam.export.grid.settings import GridSettings
from splitslam.export.grid.spool import View

Array = NDArray[np.float64]
_CLEAR_CELLS = 1.5  # so far before the surface that it hits, measured across it, a ray says nothing
_FLATTEST = 0.05  # cosine of the incidence
_NEIGHBOUR = 0.06  # of the range: points of one surface in one ring are nearer to each other
_NEIGHBOUR_M = 0.6
_BETWEEN_CELLS = 2.0  # between rays at their ends
_DIRECTIONS = 720
_SAME_M = 0.1  # of height: a third of a layer


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Of the view `number`: its sensor (3,); what it hit (H, 3): x, y, height over ground; and how far it saw freely,
    the ends (M, 3) of its rays; float64, m, `map`.
    """

    number: int
    sensor: Array
    hits: Array
    ends: Array


class RayMaker:
    """For one grid."""

    def __init__(self, ground: Ground, settings: GridSettings) -> None:
        self._ground, self._settings = ground, settings

    def of(self, view: View) -> Rays:
        """Of rays that end in the same cell at the same height, all of which pass the same cells, there is one."""
        s = self._settings
        standing, over_m = self._standing(view.points)
        level = view.points[:, :2] - view.sensor[:2]
        range_m = np.hypot(level[:, 0], level[:, 1])
        hit = standing & (range_m <= s.range_m)
        hits = np.column_stack([view.points[hit, :2], over_m[hit]])
        margin_m = np.where(standing, self._margin_m(view, level, range_m), 0.0)
        ends, margin_m = with_those_between(view, standing, margin_m, _BETWEEN_CELLS * s.resolution_m)
        range_m = np.maximum(np.hypot(*(ends[:, :2] - view.sensor[:2]).T), 1e-6)
        stops = np.clip(np.minimum(1.0 - margin_m / range_m, s.range_m / range_m), 0.0, 1.0)
        seen = view.sensor + stops[stops > 0.0, None] * (ends[stops > 0.0] - view.sensor)
        return Rays(view.number, view.sensor, hits, seen[distinct(seen, s.resolution_m)])

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


class RaySpool:
    """Written once, read as often as wanted."""

    def __init__(self, path: Path, all_rays: Iterable[Rays]) -> None:
        """path: to be made. all_rays: of views 0, 1, 2, ..."""
        self._path = path
        self._sensors: list[Array] = []
        self._counts: list[tuple[int, int]] = []
        self._starts = [0]
        with path.open("wb") as file:
            for rays in all_rays:
                both = np.concatenate([rays.hits - [*rays.sensor[:2], 0.0], rays.ends - rays.sensor])
                file.write(both.astype("<f4").tobytes())  # from the sensor: to a micrometre, however large the map
                self._sensors.append(rays.sensor)
                self._counts.append((len(rays.hits), len(rays.ends)))
                self._starts.append(self._starts[-1] + 12 * len(both))

    def rays(self, numbers: Iterable[int]) -> Iterator[Rays]:
        """Those of these views, one at a time."""
        with self._path.open("rb") as file:
            for k in numbers:
                sensor, (hits, ends) = self._sensors[k], self._counts[k]
                file.seek(self._starts[k])
                both = np.fromfile(file, "<f4", 3 * (hits + ends)).reshape(-1, 3).astype(np.float64)
                yield Rays(k, sensor, both[:hits] + [*sensor[:2], 0.0], both[hits:] + sensor)


def distinct(ends: Array, cell_m: float) -> NDArray[np.int64]:
    """Rows of ends (M, 3), m, one for each cell and height that they lie in."""
    if not len(ends):
        return np.zeros(0, np.int64)
    cells = np.floor(ends / [cell_m, cell_m, _SAME_M]).astype(np.int64)
    cells -= cells.min(axis=0)
    size = cells.max(axis=0) + 1
    return np.unique((cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2], return_index=True)[1]


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
