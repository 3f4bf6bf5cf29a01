"""Kernels that thin and choose features, against naive twins; without the JIT too."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.features import _choice_kernels as kernels
from edge_agent.features import _thinning_kernels as thinning
from edge_agent.features.integer import FLAT
from tests.features import naive
from tests.features.test_kernels import columns_with_gaps


def thinned(points: np.ndarray, rank: np.ndarray, ring_start: np.ndarray) -> np.ndarray:
    table, sums = np.full((512, 2), 3, np.int64), np.full((172, 6), 7.0)
    kept = np.full(len(points), -9, np.int32)
    count = thinning.thin_surfs(points, rank, ring_start, 0.4, table, sums, kept)
    return kept[:count]


def test_surfs_are_thinned_to_the_real_point_nearest_to_each_voxels_centroid():
    rng = np.random.default_rng(5)
    ring_start = np.array([0, 120, 120, 128, 300], np.int32)
    points = rng.uniform(-0.75, 0.75, (300, 3)).astype(np.float32)
    rank = (rng.random(300) < 0.1).astype(np.uint8)
    expected = np.flatnonzero(naive.thin(points, rank, ring_start, 0.4))
    np.testing.assert_array_equal(thinned(points, rank, ring_start), expected)
    assert 50 < len(expected) < 200


def test_a_walls_points_come_in_runs_of_a_voxel_that_corners_do_not_end():
    rng = np.random.default_rng(6)
    ring_start = np.array([0, 150, 300], np.int32)
    way = np.tile(np.linspace(-3.0, 3.0, 150), 2)
    points = np.stack([way, 0.1 * np.sin(7 * way), np.repeat([-0.3, 0.1], 150)], axis=1).astype(np.float32)
    rank = np.zeros(300, np.uint8)
    rank[[5, 60, 61, 149, 155, 293]] = 1  # the first and the last that count among them
    rank[100:130] = 2  # a voxel without surfs
    points[200:210] = points[160:170] + rng.normal(0, 0.01, (10, 3))  # back in a voxel of before
    expected = np.flatnonzero(naive.thin(points, rank, ring_start, 0.4))
    np.testing.assert_array_equal(thinned(points, rank, ring_start), expected)
    assert 40 < len(expected) < 60


def test_a_corner_in_a_voxel_is_not_its_surf_however_near_to_the_centroid():
    points = np.zeros((31, 3), np.float32)
    points[:, 0] = np.linspace(0.01, 0.39, 31)  # one voxel
    rank = np.zeros(31, np.uint8)
    rank[[14, 15]] = 1, 2
    kept = thinned(points, rank, np.array([0, 31], np.int32))
    assert kept.tolist() == np.flatnonzero(naive.thin(points, rank, np.array([0, 31]), 0.4)).tolist()
    assert len(kept) == 1
    assert abs(int(kept[0]) - 14.5) < 2


def test_rings_without_surfs_leave_none():
    ring_start = np.array([0, 0, 11, 12, 40], np.int32)  # none, too short for a window, one point, corners alone
    points = np.random.default_rng(1).normal(size=(40, 3)).astype(np.float32)
    assert len(thinned(points, np.ones(40, np.uint8), ring_start)) == 0


def test_the_sharpest_of_every_sector_come_before_the_second_of_any():
    rng = np.random.default_rng(3)
    rank = rng.integers(1, 6, 100).astype(np.uint8)
    per_rank = np.bincount(rank, minlength=6)
    chosen = np.empty(100, np.bool_)
    for target in (0, 1, int(per_rank[1]), int(per_rank[1:3].sum()) + 3, 1000):
        chosen[:] = True
        taken = kernels.sharpest(rank, target, chosen)
        assert taken == chosen.sum() == min(target, 100)
        ranks = rank[chosen]
        whole = ranks.max(initial=0)  # all below it are there
        assert all((ranks == r).sum() == per_rank[r] for r in range(1, whole))
        places = np.flatnonzero(chosen[rank == whole]) if whole else np.zeros(0)
        if 1 < len(places) < per_rank[whole]:
            assert np.diff(places).max() - np.diff(places).min() <= 1
    assert kernels.sharpest(np.zeros(0, np.uint8), 5, np.zeros(0, np.bool_)) == 0


@pytest.mark.parametrize("target", [0, 1, 7, 40, 80, 1000])
def test_spread_takes_the_wanted_number_evenly(target: int):
    chosen = np.ones(80, np.bool_)
    taken = kernels.spread(target, chosen)
    assert taken == chosen.sum() == min(target, 80)
    places = np.flatnonzero(chosen)
    if 1 < taken < 80:
        assert np.diff(places).max() - np.diff(places).min() <= 1


def test_which_way_surfaces_face_is_told_from_their_neighbours():
    rng = np.random.default_rng(8)
    ring_start = np.array([0, 90, 90, 92, 200, 300], np.int32)
    column = columns_with_gaps(rng, ring_start)
    azimuth, elevation = column * 0.02, np.radians(np.repeat(np.arange(5) * 4.0 - 8, np.diff(ring_start)))
    p = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], axis=1)
    points = (p * rng.uniform(4, 9, (300, 1))).astype(np.float32)
    keep = rng.random(300) < 0.7
    index = np.flatnonzero(keep).astype(np.int32)
    group = np.full(len(index), 99, np.uint8)
    kernels.facing(points, column, ring_start, index, group)
    expected = naive.facing(points, column, ring_start, keep)
    assert dict(zip(index.tolist(), group.tolist(), strict=True)) == expected
    assert len(set(expected.values())) >= 10


@pytest.mark.parametrize("degrees", range(-180, 181, 15))
def test_walls_are_told_by_eighths_of_a_turn_that_begin_at_their_own_angle(degrees: int):
    """45 degrees and its multiples belong to the eighth that begins there."""
    nx, ny = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    if degrees % 45 == 0:
        nx, ny = np.sign(nx) * (abs(nx) > 0.1), np.sign(ny) * (abs(ny) > 0.1)
    here = np.array([-nx, -ny, 0.0])  # the wall faces the sensor
    along = np.array([-ny, nx, 0.0])
    points = np.array([here - along, here, here + along, here + [0.0, 0.0, 1.0]], np.float32)
    assert kernels.facing_of(points, 1, 3) == degrees % 360 // 45


@pytest.mark.parametrize("target", [0, 1, 7, 40, 111, 1000])
def test_groups_share_alike_and_what_small_ones_lack_goes_to_the_others(target: int):
    rng = np.random.default_rng(target)
    group = np.minimum(rng.geometric(0.4, 200) - 1, 10).astype(np.uint8)
    chosen = np.ones(200, np.bool_)
    taken = kernels.spread_by_group(group, target, chosen)
    counts = np.bincount(group, minlength=11)
    assert taken == chosen.sum() == min(target, 200)
    np.testing.assert_allclose(np.bincount(group[chosen], minlength=11), naive.shares(counts, target), atol=1)


@pytest.mark.parametrize("target", [0, 9, 60, 100, 150, 1000])
def test_flat_ones_that_face_all_ways_come_before_any_rough_one(target: int):
    rng = np.random.default_rng(target)
    ring_start = np.array([0, 90, 200, 300], np.int32)
    column, points = columns_with_gaps(rng, ring_start), rng.normal(size=(300, 3)).astype(np.float32)
    marks = rng.choice([0, 1, 2, FLAT], 300, p=[0.3, 0.1, 0.1, 0.5]).astype(np.uint8)
    surfs = np.flatnonzero(rng.random(300) < 0.7).astype(np.int32)
    flat, rough = surfs[marks[surfs] == FLAT], surfs[marks[surfs] != FLAT]
    group, chosen = np.empty(len(flat), np.uint8), np.empty(len(flat), np.bool_)
    kernels.facing(points, column, ring_start, flat, group)
    kernels.spread_by_group(group, target, chosen)
    others = np.zeros(len(rough), np.bool_)
    kernels.spread(target - chosen.sum(), others)
    expected = np.union1d(flat[chosen], rough[others])
    kept = np.full(300, -9, np.int32)
    count = kernels.facing_all_ways(points, column, ring_start, surfs, marks, target, kept)
    np.testing.assert_array_equal(kept[:count], expected)
    assert count == min(target, len(surfs))


@pytest.mark.parametrize("target", [0, 5, 40, 1000])
def test_what_is_chosen_of_a_list_is_picked_out_of_it_in_its_order(target: int):
    rng = np.random.default_rng(target)
    rank = rng.integers(0, 5, 200).astype(np.uint8)
    corners, kept, chosen = np.flatnonzero(rank).astype(np.int32), np.empty(200, np.int32), np.empty(200, np.bool_)
    chosen = chosen[: len(corners)]
    kernels.sharpest(rank[corners], target, chosen)
    np.testing.assert_array_equal(kept[: kernels.sharpest_of(rank, corners, target, kept)], corners[chosen])
    kernels.spread(target, chosen)
    np.testing.assert_array_equal(kept[: kernels.spread_of(corners, target, kept)], corners[chosen])


def test_features_are_taken_with_what_the_scan_says_of_them():
    rng = np.random.default_rng(2)
    points, column = rng.normal(size=(20, 3)).astype(np.float32), np.arange(20, dtype=np.uint16)
    source = np.arange(19, -1, -1)
    ring, times, intensity = (rng.integers(0, 99, 30).astype(kind) for kind in (np.uint8, np.int32, np.uint8))
    index = np.array([0, 3, 19], np.int32)
    taken = np.empty((3, 3), np.float32), *(np.empty(3, kind) for kind in (np.uint8, np.uint16, np.int32, np.uint8))
    kernels.take((points, column, source.astype(np.int32), ring, times, intensity), index, taken)
    at = source[index]
    for got, expected in zip(taken, (points[index], ring[at], column[index], times[at], intensity[at]), strict=True):
        np.testing.assert_array_equal(got, expected)
