"""Thinning in bounded memory."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam._voxel_kernels import EMPTY, take
from splitslam.thinning import TakenVoxels, voxel_problem


def taken_naively(points: np.ndarray, voxel_m: float, seen: set[tuple[int, ...]]) -> list[int]:
    rows = []
    for row, point in enumerate(points):
        cell = tuple(np.floor(point / voxel_m).astype(int).tolist())
        if cell not in seen:
            seen.add(cell)
            rows.append(row)
    return rows


def test_the_table_takes_each_key_once() -> None:
    rng = np.random.default_rng(5)
    table, seen = np.full(1024, EMPTY, np.uint32), set()
    for _ in range(5):
        keys = rng.integers(0, 400, 150).astype(np.uint32)
        first = np.empty(len(keys), np.bool_)
        expected = []
        for key in keys.tolist():
            expected.append(key not in seen)
            seen.add(key)
        assert take(keys, table, first) == sum(expected)
        assert first.tolist() == expected
    assert set(table[table != EMPTY].tolist()) == seen


@pytest.mark.parametrize("memory_bytes", [128 << 20, 2000], ids=["all in memory", "nearly all on disk"])
@pytest.mark.parametrize("voxel_m", [0.05, 2.0])
def test_each_voxel_keeps_its_first_point_wherever_its_tile_is(voxel_m: float, memory_bytes: int) -> None:
    rng = np.random.default_rng(4)
    seen: set[tuple[int, ...]] = set()
    with TakenVoxels(voxel_m, memory_bytes) as taken:
        for k in range(12):  # there and back again
            around = np.array([abs(k - 6) * 20.0 - 50.0, 0.0, 0.0])
            points = np.round(rng.uniform(-15, 15, (800, 3)) * [1, 1, 0.1], 1) + around
            assert taken.first(points).tolist() == taken_naively(points, voxel_m, seen)
        assert (taken.on_disk > 0) == (memory_bytes == 2000)
        assert taken.first(np.empty((0, 3))).tolist() == []


def test_a_voxel_of_a_wrong_size_is_said_to_be_so() -> None:
    assert voxel_problem(0.0) is None
    assert voxel_problem(0.1) is None
    for wrong in (0.001, 1000.0, -1.0, float("nan")):
        assert "expected 0 or 0.01 to 100" in str(voxel_problem(wrong))
