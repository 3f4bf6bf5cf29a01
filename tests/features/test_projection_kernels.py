"""Kernels of the range image against naive twins, without the JIT too."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.features import _projection_kernels as kernels
from tests.features import naive


@pytest.mark.parametrize(("rings", "columns"), [(4, 36), (16, 1800), (5, 2048), (5, 2083)])
def test_projection_is_lio_sams_and_the_first_return_wins(rings: int, columns: int):
    rng = np.random.default_rng(rings)
    n = 600
    # keep off the cells' borders, where float32 and float64 may round apart
    azimuth = 2 * np.pi / columns * (rng.integers(0, columns, n) + rng.uniform(-0.49, 0.49, n))
    azimuth[:8] = np.array([0, 0.5, 1, 1.5, 2, -0.5, -1, 0.25]) * np.pi
    r = rng.uniform(1, 50, n)
    points = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), rng.normal(size=n)], axis=1).astype(np.float32)
    ring = rng.integers(0, rings + 1, n).astype(np.uint8)
    cells = np.empty((rings, columns), np.int32)
    counts, ranges = np.empty(2, np.int64), np.empty(n, np.int32)
    kernels.project(points, ring, cells, ranges, counts)
    expected, taken, outside = naive.project(points, ring, rings, columns)
    assert {(r, c): int(cells[r, c]) for r, c in np.argwhere(cells >= 0)} == expected
    assert counts.tolist() == [taken, outside]
    np.testing.assert_array_equal(ranges, [naive.range_units(p) for p in points])
    assert taken > 0
    assert outside > 0


def test_gather_lays_points_out_by_ring_then_column():
    rng = np.random.default_rng(0)
    cells = np.full((5, 40), -1, np.int32)
    filled = rng.choice(200, 60, replace=False)
    cells.reshape(-1)[filled] = rng.permutation(60)
    cells[2] = -1  # a ring without returns
    points = rng.normal(size=(60, 3)).astype(np.float32)
    total = int((cells >= 0).sum())
    ranges = rng.integers(1, 9999, 60).astype(np.int32)
    out, range_q = np.empty((200, 3), np.float32), np.empty(200, np.int32)
    column, source, start = np.empty(200, np.uint16), np.empty(200, np.int32), np.empty(6, np.int32)
    n = kernels.gather(cells, points, ranges, out, range_q, column, source, start)
    order = [(r, c, int(cells[r, c])) for r in range(5) for c in range(40) if cells[r, c] >= 0]
    assert n == total == len(order)
    np.testing.assert_array_equal(source[:n], [i for _, _, i in order])
    np.testing.assert_array_equal(column[:n], [c for _, c, _ in order])
    np.testing.assert_array_equal(out[:n], points[source[:n]])
    np.testing.assert_array_equal(range_q[:n], ranges[source[:n]])
    assert start.tolist() == [sum(r < k for r, _, _ in order) for k in range(6)]


def test_a_range_is_rounded_the_same_way_whatever_the_point():
    rng = np.random.default_rng(1)
    points = (rng.normal(size=(2000, 3)) * 10 ** rng.uniform(-5, 2.6, (2000, 1))).astype(np.float32)
    points[:4] = [[0, 0, 0], [300, 0, 0], [2**-15, 0, 0], [255.99951, 0, 0]]
    found = np.empty(2000, np.int32)
    x, y, z = np.ascontiguousarray(points.T)
    kernels.range_units(x, y, z, found)
    np.testing.assert_array_equal(found, [naive.range_units(p) for p in points])
    assert found[:2].tolist() == [1, 2**18 - 1]
