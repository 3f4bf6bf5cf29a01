"""The octree behind COPC files."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

from splitslam.export.clouds import octree
from splitslam.export.clouds.las import STEP_M, las_records
from splitslam.export.clouds.octree import CELLS, Octree
from splitslam.export.placing import InMap
from tests.export.made import joined, pieces

MADE = pieces(count=4, points=6000)


def filled(folder: Path) -> Octree:
    tree = Octree(folder, laspy.PointFormat(6).dtype())
    for piece in MADE:
        tree.add(las_records(piece, InMap()))
    return tree


@pytest.mark.parametrize("cube_points", [2_000_000, 1_000], ids=["whole cubes", "cubes that are split"])
def test_each_point_is_in_one_node_that_holds_its_place(
    cube_points: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(octree, "_LEAF_POINTS", 100)
    monkeypatch.setattr(octree, "_CUBE_POINTS", cube_points)
    tree = filled(tmp_path)
    root = tree.root()
    nodes = list(tree.nodes())
    assert len({node for node, _ in nodes}) == len(nodes)
    found = []
    for (depth, *place), records in nodes:
        steps = np.column_stack([records[axis].astype(np.int64) for axis in "XYZ"])
        low = np.array(root.corner) + np.array(place) * (1 << (root.shift - depth))
        assert (steps >= low).all()
        assert (steps < low + (1 << (root.shift - depth))).all()
        found.append(steps)
    expected = np.rint(joined(MADE)[:, :3] / STEP_M).astype(np.int64)
    found = np.concatenate(found)
    np.testing.assert_array_equal(found[np.lexsort(found.T)], expected[np.lexsort(expected.T)])


def test_every_node_hangs_on_the_root_and_is_spread_over_its_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(octree, "_LEAF_POINTS", 100)
    tree = filled(tmp_path)
    root = tree.root()
    nodes = dict(tree.nodes())
    for (depth, x, y, z), records in nodes.items():
        if depth:
            assert (depth - 1, x // 2, y // 2, z // 2) in nodes
        cells = np.column_stack([(records[axis].astype(np.int64) - corner) >> (root.shift - depth - CELLS)
                                 for axis, corner in zip("XYZ", root.corner, strict=True)])  # fmt: skip
        inner = any(
            (depth + 1, 2 * x + i, 2 * y + j, 2 * z + k) in nodes for i in (0, 1) for j in (0, 1) for k in (0, 1)
        )
        if inner:  # a leaf keeps what is left
            assert len(np.unique(cells, axis=0)) == len(records)


def test_what_was_spooled_is_gone_afterwards(tmp_path: Path) -> None:
    list(filled(tmp_path).nodes())
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
