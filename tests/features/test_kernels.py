"""Kernels against naive twins; also run with NUMBA_DISABLE_JIT=1 (tests/test_kernels_without_the_jit.py)."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

from edge_agent.features import _kernels as kernels
from edge_agent.features.integer import CORNER, Limits
from edge_agent.settings import FeatureSettings
from tests.features import naive


def ranges(rng: np.random.Generator, n: int) -> np.ndarray:
    """Walls, steps and noise: all branches of the marks and many corners."""
    steps = np.repeat(rng.uniform(2, 12, n // 9 + 1), 9)[:n]
    return np.rint(1024 * (steps + rng.normal(0, 0.02, n) + 0.3 * (rng.random(n) < 0.1))).astype(np.int32)


def columns_with_gaps(rng: np.random.Generator, ring_start: np.ndarray) -> np.ndarray:
    column = np.empty(ring_start[-1], np.uint16)
    for a, b in pairwise(ring_start):
        column[a:b] = np.cumsum(np.where(rng.random(b - a) < 0.05, rng.integers(2, 25, b - a), 1))
    return column


RINGS = np.cumsum([0, 0, 1, 5, 10, 11, 12, 13, 17, 18, 300, 1]).astype(np.int32)  # too short for windows, sectors; long


def test_curvature_is_the_sum_of_range_differences_within_a_ring():
    r = ranges(np.random.default_rng(3), int(RINGS[-1]))
    out = np.full(len(r), -1, np.int32)
    kernels.differences(r, RINGS, out)
    np.testing.assert_array_equal(out, naive.differences(r, RINGS))
    assert out.max() > 1024


def test_occluded_points_and_parallel_beams_are_marked():
    rng = np.random.default_rng(4)
    r = ranges(rng, int(RINGS[-1]))
    column = columns_with_gaps(rng, RINGS)
    marks = np.full(len(r), 7, np.uint8)
    kernels.unreliable(r, column, RINGS, 307, marks)
    np.testing.assert_array_equal(marks.astype(bool), naive.unreliable(r, column, RINGS, 307))
    assert 20 < marks.sum() < len(r) - 20


@pytest.mark.parametrize("sectors", [1, 6, 7])
def test_candidates_lie_in_the_sectors_of_lio_sam_and_are_not_masked(sectors: int):
    rng = np.random.default_rng(sectors)
    d = rng.integers(0, 1500, int(RINGS[-1])).astype(np.int32)
    d[::7], d[1::7] = 324, 1024  # the limits themselves are neither
    masked = rng.random(len(d)) < 0.2
    marks, sector = masked.astype(np.uint8), np.full(len(d), 9, np.uint8)
    kernels.candidates(d, RINGS, 1024, 324, sectors, marks, sector)
    expected = naive.sector_of(RINGS, sectors)
    np.testing.assert_array_equal(sector, expected)
    free = ~masked & (expected < 7)
    np.testing.assert_array_equal(marks, masked + 2 * (free & (d > 1024)) + 4 * (free & (d < 324)))


def test_no_integer_tells_the_limits_from_the_settings():
    limits = Limits.of(FeatureSettings())
    assert (limits.occlusion, limits.corner, limits.flat) == (307, 1024, 324)
    for d in range(1, 3000):
        curvature_m2 = Fraction(d, 1024) ** 2
        assert (d > limits.corner) == (curvature_m2 > 1)
        assert (d < limits.flat) == (curvature_m2 < Fraction(1, 10))


@pytest.mark.parametrize("largest", [1, 3, 20])
def test_corners_are_the_sharpest_of_each_sector_and_suppress_their_neighbours(largest: int):
    rng = np.random.default_rng(largest)
    ring_start = np.array([0, 150, 155, 155, 400], np.int32)  # rings of five and of no points among them
    n = int(ring_start[-1])
    d = rng.integers(0, 3000, n).astype(np.int32)
    column = columns_with_gaps(rng, ring_start)
    corner = (d > 1024) & (rng.random(n) > 0.2)
    rank, picked = np.full(n, 9, np.uint8), np.full(n, 7, np.uint8)
    total = kernels.select_corners(d, corner * np.uint8(CORNER), column, picked, ring_start, 6, largest, rank)
    expected = naive.corner_ranks(d, corner, column, ring_start, 6, largest)
    np.testing.assert_array_equal(rank, expected)
    assert total == np.count_nonzero(expected) > 4
