"""Thinning a map that does not fit into memory: each voxel keeps its first point."""

from __future__ import annotations

import tempfile
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from splitslam._voxel_kernels import EMPTY, take
from splitslam.maps import MapPiece

MIN_VOXEL_M = 0.01
MAX_VOXEL_M = 100.0
_TILE = 9  # bits: a tile has 512 voxels a side
_REACH = 1 << 29  # voxels: 5,000 km at the smallest
_FULL = 0.6


def voxel_problem(voxel_m: float) -> str | None:
    """Why a map cannot be thinned to voxels of this size, or None."""
    if voxel_m == 0 or MIN_VOXEL_M <= voxel_m <= MAX_VOXEL_M:  # false for NaN
        return None
    return f"{voxel_m:g}: expected 0 or {MIN_VOXEL_M:g} to {MAX_VOXEL_M:g}"


@dataclass(slots=True, eq=False)
class _Tile:
    """The voxels taken in one cube of the world: a hash table of their numbers within it."""

    table: NDArray[np.uint32]
    count: int

    def take(self, voxels: NDArray[np.uint32]) -> NDArray[np.bool_]:
        """Which of them (N,) are new; they are taken now."""
        if self.count + len(voxels) > _FULL * len(self.table):
            kept = self.table[self.table != EMPTY]
            self.table = _table(2 * (self.count + len(voxels)))
            take(kept, self.table, np.empty(len(kept), np.bool_))
        first = np.empty(len(voxels), np.bool_)
        self.count += take(voxels, self.table, first)
        return first


class TakenVoxels:
    """Which voxels of the world have their point. Tiles not needed for long wait on disk; a robot comes back to few."""

    def __init__(self, voxel_m: float, memory_bytes: int = 128 << 20) -> None:
        """memory_bytes: of tables in memory; of which those that one piece of the map touches may be more."""
        self._voxel_m, self._memory_bytes = voxel_m, memory_bytes
        self._tiles: OrderedDict[int, _Tile] = OrderedDict()  # those in memory, the longest unused first
        self._folder = tempfile.TemporaryDirectory(prefix="splitslam-voxels-")
        self._counts: dict[int, int] = {}  # of the tiles on disk

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    @property
    def on_disk(self) -> int:
        """Tiles that are not in memory."""
        return len(self._counts)

    def first(self, points: NDArray[np.float64]) -> NDArray[np.intp]:
        """Rows of points (N, 3), m, that are the first of their voxel, in order."""
        cells = np.floor(points / self._voxel_m).astype(np.int64) + _REACH
        tiles = cells >> _TILE
        inside = cells & ((1 << _TILE) - 1)
        voxels = ((inside[:, 0] << 2 * _TILE) | (inside[:, 1] << _TILE) | inside[:, 2]).astype(np.uint32)
        keys = (tiles[:, 0] << 42) | (tiles[:, 1] << 21) | tiles[:, 2]
        order = np.argsort(keys, kind="stable")
        starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
        new = np.empty(len(points), np.bool_)
        for rows in np.split(order, starts[1:]) if len(order) else []:
            new[rows] = self._tile(int(keys[rows[0]])).take(voxels[rows])
        self._shrink()
        return np.flatnonzero(new)

    def _tile(self, key: int) -> _Tile:
        tile = self._tiles.get(key)
        if tile is None:
            tile = (
                _Tile(np.load(self._path(key)), self._counts.pop(key)) if key in self._counts else _Tile(_table(8), 0)
            )
            self._tiles[key] = tile
        self._tiles.move_to_end(key)
        return tile

    def _shrink(self) -> None:
        size = sum(tile.table.nbytes for tile in self._tiles.values())
        while size > self._memory_bytes and len(self._tiles) > 1:
            key, tile = self._tiles.popitem(last=False)
            np.save(self._path(key), tile.table)
            self._counts[key] = tile.count
            size -= tile.table.nbytes

    def _path(self, key: int) -> Path:
        return Path(self._folder.name) / f"{key:x}.npy"


def _table(room: int) -> NDArray[np.uint32]:
    """An empty one for `room` entries and as many again."""
    return np.full(1 << max(6, int(2 * room - 1).bit_length()), EMPTY, np.uint32)


def thinned(pieces: Iterable[MapPiece], voxel_m: float) -> Iterator[MapPiece]:
    """Each voxel of the whole map keeps its first point; all of them for 0."""
    if voxel_m == 0:
        yield from pieces
        return
    with TakenVoxels(voxel_m) as taken:
        for piece in pieces:
            kept = taken.first(piece.points_map[:, :3].astype(np.float64))
            yield replace(piece, points_map=piece.points_map[kept])
