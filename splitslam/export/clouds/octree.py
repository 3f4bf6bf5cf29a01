"""A map as an octree of samples, each point in one node: the coarse nodes first, finer ones below them.

A node of depth k keeps one point of each cell, 1/128 of its side, that no node above has kept. Below the cubes of
TileFiles a node with few points left keeps them all. Cells lie within cubes, so each cube is looked at once, alone.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitslam.export.clouds.tiles import Tile, TileFiles, cell_keys, grouped

Node = tuple[int, int, int, int]  # depth, x, y, z: as COPC's VoxelKey
CELLS = 7  # bits: 128 cells a side of a node
_LEAF_POINTS = 50_000
_CUBE_POINTS = 2_000_000
_SMALLEST = 11  # bits of a cube's side in steps


@dataclass(frozen=True, slots=True)
class Root:
    """The cube that holds the map, in steps. shift: log2 of its side."""

    corner: Tile
    shift: int


class Octree:
    """Takes records with X, Y, Z in int32 steps, then gives the nodes, each once and whole. Works on disk."""

    def __init__(self, folder: Path, dtype: np.dtype, cube_shift: int = 18) -> None:
        """cube_shift: log2 of the side of a cube, in steps (18: 26 m of 0.1 mm)."""
        self._folder, self._dtype = folder, dtype
        self._cubes = self._files(cube_shift)

    def add(self, records: NDArray) -> None:
        """(N,) records of a part of the map."""
        self._cubes.add(records)

    @property
    def points(self) -> int:
        """All that were added."""
        return sum(self._cubes.counts.values())

    def root(self) -> Root:
        """The smallest cube of cubes from the lowest corner on."""
        cubes = np.array(list(self._cubes.counts) or [(0, 0, 0)])
        low, high = cubes.min(axis=0), cubes.max(axis=0)
        side = int((high - low).max())
        corner = tuple(int(v) << self._cubes.shift for v in low)
        return Root((corner[0], corner[1], corner[2]), self._cubes.shift + side.bit_length())

    def nodes(self) -> Iterator[tuple[Node, NDArray]]:
        """Every node with its records. What was added is gone afterwards."""
        root = self.root()
        shared = _Shared(self._folder, self._dtype)
        for cube, count in sorted(self._cubes.counts.items()):
            yield from self._cube(self._cubes, cube, count, root, shared)
        yield from shared.nodes()

    def _cube(
        self, files: TileFiles, cube: Tile, count: int, root: Root, shared: _Shared
    ) -> Iterator[tuple[Node, NDArray]]:
        """Nodes within one cube; what belongs to nodes that are larger than it goes to `shared`."""
        if count > _CUBE_POINTS and files.shift > _SMALLEST:
            parts = self._files(files.shift - 1)
            for records in files.take(cube, self._dtype, _CUBE_POINTS):
                parts.add(records)
            for part, part_count in sorted(parts.counts.items()):
                yield from self._cube(parts, part, part_count, root, shared)
            return
        (records,) = files.take(cube, self._dtype)
        depth = 0
        while len(records):
            node_shift = root.shift - depth
            kept = _first_in_cells(records, min(node_shift - CELLS, files.shift), root)
            if node_shift <= files.shift:
                node_keys = cell_keys(_relative(records, root), node_shift)
                for rows in grouped(node_keys):
                    if len(rows) <= _LEAF_POINTS or node_shift <= _SMALLEST:
                        kept[rows] = True
                    yield _node(records[rows[:1]], depth, node_shift, root), records[rows[kept[rows]]]
            else:
                shared.add(_node(records[:1], depth, node_shift, root), records[kept])
            records = records[~kept]
            depth += 1

    def _files(self, shift: int) -> TileFiles:
        return TileFiles(Path(tempfile.mkdtemp(dir=self._folder)), shift)


class _Shared:
    """Nodes that several cubes add to, on disk until all have."""

    def __init__(self, folder: Path, dtype: np.dtype) -> None:
        self._folder, self._dtype = Path(tempfile.mkdtemp(dir=folder)), dtype
        self._names: set[Node] = set()

    def add(self, node: Node, records: NDArray) -> None:
        self._names.add(node)
        with self._path(node).open("ab") as file:
            file.write(records.tobytes())

    def nodes(self) -> Iterator[tuple[Node, NDArray]]:
        for node in sorted(self._names):
            yield node, np.fromfile(self._path(node), self._dtype)
            self._path(node).unlink()

    def _path(self, node: Node) -> Path:
        return self._folder / "{}_{}_{}_{}".format(*node)


def _first_in_cells(records: NDArray, cell_shift: int, root: Root) -> NDArray[np.bool_]:
    """Which records are the first of their cell of 2^cell_shift steps."""
    kept = np.zeros(len(records), bool)
    if cell_shift <= 0:
        kept[:] = True
        return kept
    _, first = np.unique(cell_keys(_relative(records, root), cell_shift), return_index=True)
    kept[first] = True
    return kept


def _relative(records: NDArray, root: Root) -> dict[str, NDArray[np.int64]]:
    """X, Y, Z from the root's corner on."""
    return {axis: records[axis].astype(np.int64) - corner for axis, corner in zip("XYZ", root.corner, strict=True)}


def _node(record: NDArray, depth: int, node_shift: int, root: Root) -> Node:
    x, y, z = (int(values[0]) >> node_shift for values in _relative(record, root).values())
    return depth, x, y, z
