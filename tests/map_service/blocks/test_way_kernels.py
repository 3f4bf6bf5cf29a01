"""Kernels of stored ways against splitslam.se3."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from map_service import _way_kernels as kernels
from splitslam import se3
from tests.map_service.blocks.made_scans import circling, furthest

STEPS = np.array([1e-5, 1e-4])
GAINS = np.array([0.6, 0.25])
TIMES_S = np.arange(60) * 0.1
LIMITS = np.array([math.radians(0.05), 1e-3, 2e-3])


def apart_naively(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    between = se3.inv(A) @ B
    return np.concatenate([se3.so3_log(between[:3, :3]), between[:3, 3]])


def between_naively(T_a: np.ndarray, T_b: np.ndarray, share: float) -> np.ndarray:
    return T_a @ se3.exp(share * se3.log(se3.inv(T_a) @ T_b))


def test_poses_apart_and_moved_are_those_of_se3() -> None:
    A, B = circling(20, seed=1), circling(20, speed_mps=3.0, seed=2)
    r, back = np.empty((20, 6)), np.empty_like(A)
    kernels.apart(A, B, r)
    np.testing.assert_allclose(r, [apart_naively(*pair) for pair in zip(A, B, strict=True)], atol=1e-9)
    kernels.moved(A, r, back)
    np.testing.assert_allclose(back, B, atol=1e-9)


@pytest.mark.parametrize("gains", [(1.0, 1.0), (0.6, 0.25), (0.3, 0.05)])
def test_a_way_is_told_to_half_a_step_and_read_as_it_was_told(gains: tuple[float, float]) -> None:
    way = circling(len(TIMES_S))
    numbers, coded, read = np.empty((len(way), 6), np.int64), np.empty_like(way), np.empty_like(way)
    bits = kernels.code_way(way, TIMES_S, STEPS, np.array(gains), numbers, coded)
    kernels.decode_way(numbers, TIMES_S, STEPS, np.array(gains), read)
    np.testing.assert_allclose(read, coded, atol=1e-12)
    away_m, turned_rad = furthest(read, way)
    assert away_m <= math.sqrt(3) * STEPS[1] / 2 + 1e-12
    assert turned_rad <= math.sqrt(3) * STEPS[0] / 2 + 1e-9
    assert bits == pytest.approx(np.log2(1 + 2 * np.abs(numbers)).sum())


def test_a_motion_that_goes_on_needs_no_numbers() -> None:
    """An arc without noise: after the start the filter knows it."""
    step = se3.exp(np.array([0.0, 0.0, 0.01, 0.1, 0.0, 0.0]))
    way = np.array([np.linalg.matrix_power(step, i) for i in range(60)])
    numbers, coded = np.empty((60, 6), np.int64), np.empty_like(way)
    kernels.code_way(way, TIMES_S, STEPS, np.array([1.0, 1.0]), numbers, coded)
    assert np.abs(numbers[4:]).max() <= 2
    assert np.abs(numbers[1]).max() > 100


def test_poses_that_were_left_out_lie_on_the_arc_between_those_that_were_kept() -> None:
    way, kept = circling(60), np.zeros(60, bool)
    kept[[0, 7, 8, 30, 59]] = True
    filled = way.copy()
    filled[~kept] = np.nan
    kernels.fill_way(filled, TIMES_S, kept)
    for i, (a, b) in ((3, (0, 7)), (20, (8, 30)), (58, (30, 59))):
        np.testing.assert_allclose(filled[i], between_naively(way[a], way[b], (i - a) / (b - a)), atol=1e-9)
    assert (filled[kept] == way[kept]).all()


def thinned(way: np.ndarray, times_s: np.ndarray, numbers: np.ndarray | None = None) -> np.ndarray:
    kept = np.empty(len(way), bool)
    kernels.thin_way(way, times_s, np.arange(float(len(way))) if numbers is None else numbers, LIMITS, kept)
    return kept


def test_what_is_left_out_follows_within_the_limits_and_as_much_as_a_halving_finds() -> None:
    way = circling(60, noise=2.0)
    kept = thinned(way, TIMES_S)
    at = np.flatnonzero(kept).tolist()
    assert 2 < len(at) < 30

    def fits(a: int, b: int) -> bool:
        between = [between_naively(way[a], way[b], (i - a) / (b - a)) for i in range(a + 1, b)]
        away_m, turned_rad = furthest(np.array(between), way[a + 1 : b]) if between else (0.0, 0.0)
        return away_m <= LIMITS[1] and turned_rad <= LIMITS[0]

    assert all(fits(a, b) for a, b in pairwise(at))
    assert sum(fits(a, b + 1) for a, b in pairwise(at[:-1])) <= 1


def test_a_robot_that_stands_has_two_poses() -> None:
    still = np.tile(np.eye(4), (60, 1, 1))
    assert np.flatnonzero(thinned(still, TIMES_S)).tolist() == [0, 59]


def test_a_time_that_is_not_where_its_number_would_be_is_kept() -> None:
    still, late_s = np.tile(np.eye(4), (60, 1, 1)), TIMES_S + np.where(np.arange(60) >= 40, 0.5, 0.0)
    assert {39, 40} <= set(np.flatnonzero(thinned(still, late_s)).tolist())
    numbers = np.arange(60.0) + np.where(np.arange(60) >= 40, 5.0, 0.0)  # five scans that the robot dropped
    assert np.flatnonzero(thinned(still, late_s, numbers)).tolist() == [0, 59]


@pytest.mark.parametrize("seed", range(3))
def test_a_value_is_held_until_one_of_its_row_is_off_by_more_than_its_bound(seed: int) -> None:
    values = np.cumsum(np.random.default_rng(seed).normal(0, 0.02, (50, 3)), axis=0)
    bounds, steps = np.array([0.05, 0.1, 0.2]), np.array([0.01, 0.05, 0.1])
    changed, numbers = np.empty(50, bool), np.empty((50, 3), np.int64)
    kernels.hold(values, bounds, steps, changed, numbers)
    held, changes = None, 0
    for i, row in enumerate(values):
        if held is None or (np.abs(row - held * steps) > bounds).any():
            held, changes = np.rint(row / steps).astype(int), changes + 1
            assert changed[i]
        np.testing.assert_array_equal(numbers[i], held)
    assert changed.sum() == changes < 50
