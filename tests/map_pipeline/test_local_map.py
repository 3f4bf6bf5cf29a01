from __future__ import annotations

import numpy as np
import pytest

from splitslam.registration import _kernels as kernels
from splitslam.registration.local_map import VoxelMap
from splitslam.registration.settings import VoxelSettings
from tests.map_pipeline.naive import plane_fit, room

PLANES = VoxelSettings(voxel_m=0.5, levels=3)


def voxel_index(points: np.ndarray, size: float) -> np.ndarray:
    return np.floor(points / size).astype(int)


def test_every_voxel_of_every_level_holds_the_fit_of_exactly_its_points():
    rng = np.random.default_rng(1)
    points, _ = room(rng, 1600, 0.02)
    voxels = VoxelMap(PLANES, kernels.PLANE)
    for part in np.array_split(points, 5):  # incremental insertion must not differ from one go
        voxels.insert(part, 0)
    live = np.flatnonzero(voxels.keys != -1)
    expected = {(level, *index) for level in range(3) for index in voxel_index(points, 0.5 * 2**level)}
    assert len(live) == len(expected)
    checked = 0
    for i in live:
        key = int(voxels.keys[i])
        level = key >> 60
        size = 0.5 * 2**level
        index = np.array([(key >> shift & kernels.MASK) - kernels.BIAS for shift in (40, 20, 0)])
        inside = points[(voxel_index(points, size) == index).all(axis=1)]
        assert voxels.moments[i, 0] == len(inside) > 0
        if voxels.geometry[i, kernels.KIND] == 0:
            continue
        mean, values, vectors = plane_fit(inside)
        np.testing.assert_allclose(voxels.geometry[i, :3], mean, atol=1e-9)
        np.testing.assert_allclose(voxels.geometry[i, kernels.L_MIN : kernels.L_MAX + 1], values, atol=1e-9)
        assert abs(vectors[:, 0] @ voxels.geometry[i, 3:6]) == pytest.approx(1, abs=1e-6)
        checked += 1
    assert checked > 100


def test_a_line_of_points_is_no_plane_and_a_plane_is_no_line():
    rng = np.random.default_rng(2)
    line = np.column_stack([rng.uniform(0.01, 0.49, 50), np.full(50, 0.2), np.full(50, 0.2)])
    plane = np.column_stack([rng.uniform(0.01, 0.49, (200, 2)), np.full(200, 0.2)])
    for points, kind, found in (
        (line, kernels.PLANE, False),
        (line, kernels.LINE, True),
        (plane, kernels.PLANE, True),
        (plane, kernels.LINE, False),
    ):
        voxels = VoxelMap(VoxelSettings(levels=1), kind)
        voxels.insert(points, 0)
        assert bool((voxels.geometry[:, kernels.KIND] == kind).any()) is found


def test_growing_keeps_what_was_there():
    rng = np.random.default_rng(3)
    voxels = VoxelMap(VoxelSettings(levels=1), kernels.PLANE)
    points = rng.uniform(-200, 200, (60_000, 3))
    capacity = len(voxels.keys)
    for part in np.array_split(points, 6):
        voxels.insert(part, 0)
    assert len(voxels.keys) > capacity
    assert voxels.moments[:, 0].sum() == len(points)
    assert (voxels.keys != -1).sum() == len({tuple(v) for v in voxel_index(points, 0.5)})


def test_a_point_is_matched_to_its_own_plane_and_to_none_when_too_far():
    rng = np.random.default_rng(4)
    floor = np.column_stack([rng.uniform(-5, 5, (20_000, 2)), rng.normal(0, 0.01, 20_000)])
    voxels = VoxelMap(PLANES, kernels.PLANE)
    voxels.insert(floor, 0)
    queries = np.array([[0.2, 0.2, 0.1], [0.2, 0.2, -0.1], [0.2, 0.2, 0.9], [30.0, 0.0, 0.0]])
    fits = np.empty((len(queries), kernels.GEOMETRY))
    voxels.match(queries, np.eye(4), 0.3, fits)
    assert (fits[:2, kernels.KIND] == kernels.PLANE).all()
    assert (fits[2:, kernels.KIND] == 0.0).all()
    assert abs(fits[0, 5]) > 0.99


@pytest.mark.parametrize("own", [kernels.PLANE, kernels.LINE])
def test_a_fit_is_made_when_a_point_asks_and_again_when_its_points_have_changed(own):
    rng = np.random.default_rng(16)
    surfs, corners = room(rng, 3000, 0.02)
    points = surfs if own == kernels.PLANE else corners
    voxels = VoxelMap(VoxelSettings(levels=2, min_points=5), own)
    fits = np.empty((len(points), kernels.GEOMETRY))
    for keyframe, part in enumerate(np.array_split(rng.permutation(points), 3)):
        voxels.insert(part, keyframe)
        voxels.match(points, np.eye(4), 0.4, fits)
    at_once = VoxelMap(VoxelSettings(levels=2, min_points=5), own)
    at_once.insert(points, 0)
    expected = np.empty_like(fits)
    at_once.geometry  # noqa: B018 - makes all fits
    at_once.match(points, np.eye(4), 0.4, expected)
    hit = expected[:, kernels.KIND] != 0.0
    assert hit.sum() > 100
    np.testing.assert_array_equal(fits[:, kernels.KIND], expected[:, kernels.KIND])
    sizes = slice(kernels.L_MIN, kernels.L_MAX + 1)
    np.testing.assert_allclose(fits[hit, sizes], expected[hit, sizes], atol=1e-9)
    np.testing.assert_array_equal(fits[hit, kernels.COUNT], expected[hit, kernels.COUNT])
    assert set(fits[hit, kernels.KEYFRAME]) >= {0.0, 1.0}


def test_eigen_symmetric_equals_lapack():
    rng = np.random.default_rng(6)
    for _ in range(50):
        M = rng.normal(size=(3, 3))
        A = M @ M.T * 10 ** rng.uniform(-6, 2)
        D, V = A.copy(), np.empty((3, 3))
        kernels.eigen_symmetric(D, V)
        np.testing.assert_allclose(np.sort(np.diag(D)), np.linalg.eigvalsh(A), rtol=1e-6, atol=1e-12 * np.trace(A))
        np.testing.assert_allclose(V @ np.diag(np.diag(D)) @ V.T, A, atol=1e-9 * np.trace(A))


def homes(slots, level, indices):
    return np.array([kernels.home_of(slots, np.int64(kernels.pack(level, *index))) for index in indices], np.int64)


def test_voxels_that_share_one_of_twice_the_size_are_looked_for_side_by_side():
    slots = np.full((1 << 12, 2), -1, np.int64)
    for corner in np.array([[-4, 6, 0], [100, -38, 2], [-2, -2, -2]]):
        of_one = homes(slots, 1, corner + np.indices((2, 2, 2)).reshape(3, -1).T)
        np.testing.assert_array_equal(np.sort(of_one), of_one.min() + np.arange(8))
        assert of_one.min() % 8 == 0


def test_voxels_of_a_floor_fill_the_table_evenly():
    slots = np.full((1 << 12, 2), -1, np.int64)
    floor = np.array([(x, y, 0) for x in range(-22, 22, 2) for y in range(-22, 22, 2)])
    used = len(np.unique(homes(slots, 0, floor) // 8))
    at_random = 512 * (1 - np.exp(-len(floor) / 512))
    assert used > 0.95 * at_random


def voxels_of(voxels: VoxelMap) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Key -> moments and geometry, found by the search that matching uses."""
    found = {}
    for key in voxels.keys[voxels.keys != -1].tolist():
        slot = kernels.slot_of(voxels.slots, np.int64(key))
        assert voxels.slots[slot, 0] == key
        i = voxels.slots[slot, 1]
        found[key] = voxels.moments[i, :10].copy(), voxels.geometry[i].copy()
    return found


def test_what_is_taken_out_leaves_the_map_as_if_it_had_never_been_in():
    rng = np.random.default_rng(12)
    parts = [room(rng, 500, 0.02)[0] + [0.4 * k, 0.0, 0.0] for k in range(5)]
    settings = VoxelSettings(levels=2)
    voxels = VoxelMap(settings, kernels.PLANE, capacity=1 << 12)  # crowded: searches run into each other
    for k, part in enumerate(parts):
        voxels.insert(part, k)
    for part in parts[:3]:
        voxels.remove(part)
    expected = VoxelMap(settings, kernels.PLANE)
    for k, part in enumerate(parts[3:]):
        expected.insert(part, k)
    left, right = voxels_of(voxels), voxels_of(expected)
    assert left.keys() == right.keys()
    assert np.count_nonzero(voxels.keys != -1) == len(left)
    for key, (moments, geometry) in left.items():
        np.testing.assert_allclose(moments, right[key][0], atol=1e-9)
        assert geometry[kernels.KIND] == right[key][1][kernels.KIND]
        if geometry[kernels.KIND]:
            np.testing.assert_allclose(geometry[6:9], right[key][1][6:9], atol=1e-9)


def test_an_emptied_map_is_empty():
    rng = np.random.default_rng(13)
    points = rng.uniform(-3, 3, (2000, 3))
    voxels = VoxelMap(VoxelSettings(), kernels.PLANE)
    voxels.insert(points, 0)
    voxels.remove(points)
    assert (voxels.keys == -1).all()
    assert not voxels.moments.any()
    assert not voxels.geometry[:, : kernels.NEXT].any()


def test_voxels_that_come_take_the_rows_of_those_that_went():
    rng = np.random.default_rng(22)
    voxels = VoxelMap(VoxelSettings(levels=1), kernels.PLANE, capacity=1 << 12)
    for k in range(40):
        points = rng.uniform(-3, 3, (500, 3)) + [7.0 * k, 0.0, 0.0]
        voxels.insert(points, k)
        most = voxels.used
        voxels.remove(points)
        assert 300 < most <= 500
    assert len(voxels.slots) == 1 << 12
    assert (voxels.keys == -1).all()
