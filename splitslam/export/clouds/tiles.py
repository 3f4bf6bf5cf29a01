"""Point records sorted into cubes of the world, on disk: a map of any size is looked at one cube at a time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Tile = tuple[int, int, int]
_KEY_BITS = 21
_KEY_MASK = (1 << _KEY_BITS) - 1


class TileFiles:
    """Appends records to a file for each cube of 2^shift steps; X, Y, Z are int32 fields of the records."""

    def __init__(self, folder: Path, shift: int, memory_bytes: int = 32 << 20) -> None:
        """folder: there, and empty. memory_bytes: of records that have not been written yet."""
        self._folder, self.shift, self._memory_bytes = folder, shift, memory_bytes
        self._waiting: defaultdict[Tile, list[NDArray]] = defaultdict(list)
        self._waiting_bytes = 0
        self.counts: dict[Tile, int] = {}

    def add(self, records: NDArray) -> None:
        """(N,) records go to their cubes, in order."""
        for rows in grouped(cell_keys(records, self.shift)):
            part = records[rows]
            x, y, z = (int(part[axis][0]) >> self.shift for axis in "XYZ")
            tile = x, y, z
            self._waiting[tile].append(part)
            self.counts[tile] = self.counts.get(tile, 0) + len(part)
        self._waiting_bytes += records.nbytes
        if self._waiting_bytes > self._memory_bytes:
            self._flush()

    def take(self, tile: Tile, dtype: np.dtype, at_once: int | None = None) -> Iterator[NDArray]:
        """The records of a cube, at most `at_once` at a time (None: all); the file is gone afterwards."""
        self._flush()
        path = self._path(tile)
        with path.open("rb") as file:
            while len(records := np.fromfile(file, dtype, -1 if at_once is None else at_once)):
                yield records
        path.unlink()

    def _flush(self) -> None:
        for tile, parts in self._waiting.items():
            with self._path(tile).open("ab") as file:
                for part in parts:
                    file.write(part.tobytes())
        self._waiting.clear()
        self._waiting_bytes = 0

    def _path(self, tile: Tile) -> Path:
        return self._folder / "{}_{}_{}".format(*tile)


def cell_keys(records: Any, shift: int) -> NDArray[np.int64]:
    """(N,) one number for each cell of 2^shift steps; 2^21 cells a side are told apart."""
    x, y, z = (((records[axis].astype(np.int64) >> shift) & _KEY_MASK) for axis in "XYZ")
    return (x << 2 * _KEY_BITS) | (y << _KEY_BITS) | z


def grouped(keys: NDArray[np.int64]) -> Iterator[NDArray[np.intp]]:
    """Rows of equal keys, in order."""
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    yield from (np.split(order, starts[1:]) if len(order) else ())
