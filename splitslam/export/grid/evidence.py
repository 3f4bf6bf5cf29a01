"""What the views say of a part of the grid: how often each cell was hit, how often seen through."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.export.grid._grid_kernels import HIT, MISS, mark_hits, trace_rays
from splitslam.export.grid.ground import Ground
from splitslam.export.grid.rays import Rays
from splitslam.export.grid.settings import GridSettings

Array = NDArray[np.float64]
UNKNOWN, FREE, OCCUPIED = 0, 1, 2

# Evidence of a hit and of a miss, log odds (Hornung et al., "OctoMap", Autonomous Robots 2013, section 5.1).
_HIT, _MISS = 0.85, -0.4
_LAYER_M = 0.3  # a ray over a bush says nothing of the bush: heights are told apart
_BELOW_M = -0.5  # under the ground as it is known: its own unevenness
_NOISE_SHARE = 0.1  # of the hits of a cell two away: what range noise leaves behind a surface
_SURROUNDED = 5  # free cells of eight: beams of 3 mrad are wider than their line, from 17 m on wider than a cell
_HALO = 2  # cells around a part that its own are compared with


class Evidence:
    """Counts for the cells of one part. corner (2,): of its cell (0, 0), m; shape: rows (y) and columns (x)."""

    def __init__(self, corner: Array, shape: tuple[int, int], ground: Ground, settings: GridSettings) -> None:
        cell_m = settings.resolution_m
        corner = corner - _HALO * cell_m
        shape = (shape[0] + 2 * _HALO, shape[1] + 2 * _HALO)
        standing_m = settings.max_height_m - settings.min_height_m
        layers = max(1, round(standing_m / _LAYER_M))
        self._frame = np.array([*corner, cell_m, _BELOW_M, settings.min_height_m, standing_m / layers])
        self._heights = ground.patch(corner, cell_m, shape)
        self._marks = np.full((2, 1 + layers, *shape), -1, np.int32)
        self._counts = np.zeros((2, 1 + layers, *shape), np.uint16)

    def add(self, rays: Rays) -> None:
        """One more view."""
        mark_hits(rays.hits, self._frame, self._marks, self._counts, rays.number)
        trace_rays(rays.sensor, rays.ends, self._frame, self._heights, self._marks, self._counts, rays.number)

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
