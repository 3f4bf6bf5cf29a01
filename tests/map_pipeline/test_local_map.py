from __future__ import annotations

import numpy as np
import pytest

from splitslam import se3
from splitslam.registration import _doubt_kernels as doubts
from splitslam.registration import _equation_kernels as equations
from splitslam.registration import _kernels as kernels
from splitslam.registration.local_map import VoxelMap
from splitslam.registration.settings import VoxelSettings
from tests.map_pipeline.naive import normal_equations, plane_fit, room

PLANES = VoxelSettings(voxel_m=0.5, levels=3)


def voxel_index(points: np.ndarray, size: float) -> np.ndarray:
    return np.floor(points / size).astype(int)


def test_every_voxel_of_every_level_holds_the_fit_of_exactly_its_points():
    rng = np.random.default_rng(1)
    points, _ = room(rng, 4000, 0.02)
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
        if voxels.geometry[i, 9] == 0:
            continue
        mean, values, vectors = plane_fit(inside)
        np.testing.assert_allclose(voxels.geometry[i, :3], mean, atol=1e-9)
        np.testing.assert_allclose(voxels.geometry[i, 6:9], values, atol=1e-9)
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
        assert bool((voxels.geometry[:, 9] == kind).any()) is found


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


@pytest.mark.parametrize("kind", [kernels.PLANE, kernels.LINE])
def test_the_normal_equations_equal_their_naive_twin(kind):
    rng = np.random.default_rng(5)
    surfs, corners = room(rng, 4000, 0.01)
    points = surfs if kind == kernels.PLANE else corners
    voxels = VoxelMap(PLANES if kind == kernels.PLANE else VoxelSettings(levels=2, min_points=5), kind)
    voxels.insert(points, 0)
    T = se3.exp(np.array([0.01, -0.02, 0.03, 0.05, -0.04, 0.02]))
    lidar = (points[::20] - T[:3, 3]) @ T[:3, :3] + rng.normal(0, 0.05, points[::20].shape)
    local = np.empty_like(lidar)
    equations.transform(T, lidar, local)
    np.testing.assert_allclose(local, lidar @ T[:3, :3].T + T[:3, 3], atol=1e-12)
    matched = np.empty((len(lidar), kernels.GEOMETRY))
    voxels.match(lidar, T, 0.5, matched)
    hit = matched[:, kernels.KIND] != 0.0
    assert hit.sum() > 20
    noise = np.array([0.02, 1.5, 0.5])
    H, b = np.zeros((6, 6)), np.zeros(6)
    counted, inliers, _ = equations.linearise(matched, lidar, T, noise, H, b)
    assert counted == hit.sum() >= inliers > 0
    g = matched[hit]
    n = g[:, kernels.COUNT]
    plane = kind == kernels.PLANE
    twins = [
        (n[k], g[k, :3], g[k, 3:6], g[k, 7] if plane else g[k, 8], g[k, 6] if plane else g[k, 7], plane)
        for k in range(len(g))
    ]
    expected_H, expected_b = normal_equations(lidar[hit], T, twins, noise)
    np.testing.assert_allclose(np.triu(H), np.triu(expected_H), rtol=1e-4, atol=1e-2)
    np.testing.assert_allclose(b, expected_b, rtol=1e-4, atol=1e-2)


def test_a_match_beyond_the_gate_of_a_later_iteration_counts_for_nothing():
    rng = np.random.default_rng(15)
    floor = np.column_stack([rng.uniform(-5, 5, (20_000, 2)), rng.normal(0, 0.01, 20_000)])
    voxels = VoxelMap(PLANES, kernels.PLANE)
    voxels.insert(floor, 0)
    points = np.array([[0.2, 0.2, 0.05], [0.2, 0.2, 0.35]])
    fits = np.empty((len(points), kernels.GEOMETRY))
    voxels.match(points, np.eye(4), 0.4, fits)
    counted = [
        equations.linearise(fits, points, np.eye(4), np.array([0.02, 1.5, gate_m]), np.zeros((6, 6)), np.zeros(6))[0]
        for gate_m in (0.4, 0.3, 0.04)
    ]
    assert counted == [2, 1, 0]


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
    np.testing.assert_allclose(fits[hit, 6:9], expected[hit, 6:9], atol=1e-9)
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
    parts = [room(rng, 1500, 0.02)[0] + [0.4 * k, 0.0, 0.0] for k in range(5)]
    settings = VoxelSettings(levels=2)
    voxels = VoxelMap(settings, kernels.PLANE, capacity=1 << 13)  # crowded: searches run into each other
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
        assert geometry[9] == right[key][1][9]
        if geometry[9]:
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


def test_a_step_of_levenberg_marquardt_equals_lapack_s():
    rng = np.random.default_rng(17)
    H, information, b, xi, step = np.eye(6), np.eye(6), np.zeros(6), np.zeros(6), np.empty(6)
    for _ in range(20):
        M, N, b, xi = rng.normal(size=(9, 6)), rng.normal(size=(6, 6)), rng.normal(size=6), rng.normal(size=6)
        H, information, damping = M.T @ M * 10 ** rng.uniform(-3, 6), N @ N.T, 10 ** rng.uniform(-8, 1)
        total = H + information
        assert equations.solve(np.triu(H), information, b, xi, damping, step)
        expected = np.linalg.solve(total + damping * np.diag(np.diag(total)), b - information @ xi)
        np.testing.assert_allclose(step, expected, rtol=1e-6, atol=1e-9)
    assert not equations.solve(-H, information, b, xi, 0.0, step)
    assert not step.any()


def test_information_exceeds_another_where_no_eigenvalue_of_the_difference_is_negative():
    rng = np.random.default_rng(18)
    scale, answers = np.array([5.0, 5.0, 5.0, 1.0, 1.0, 1.0]), []
    for _ in range(60):
        M, N = rng.normal(size=(12, 6)), rng.normal(size=(8, 6))
        H, other, factor = M.T @ M, N.T @ N, 10 ** rng.uniform(-2.5, 0.5)
        smallest = np.linalg.eigvalsh((H - factor * other) / np.outer(scale, scale))[0]
        assert equations.exceeds(H, other, factor, scale) == (smallest > 0)
        answers.append(smallest > 0)
    assert 10 < sum(answers) < 50


def test_a_step_moves_the_pose_and_the_scan_s_twist_and_says_by_how_much():
    rng = np.random.default_rng(19)
    M, N = rng.normal(size=(9, 6)), rng.normal(size=(6, 6))
    H, information, b = M.T @ M, N @ N.T, rng.normal(size=6)
    T_start = se3.exp(rng.normal(size=6))
    T, tangents = T_start @ se3.exp(rng.normal(0, 0.1, 6)), np.zeros((3, 6))
    tangents[0], tangents[1] = se3.log(se3.inv(T_start) @ T), rng.normal(size=6)
    gains = np.stack([rng.uniform(0, 10, 6), rng.uniform(1, 5, 6)])
    before, twist, expected = T.copy(), tangents[1].copy(), np.empty(6)
    equations.solve(H, information, b, tangents[0].copy(), 1e-6, expected)
    turned_rad, moved_m, twisted_mps = equations.advance(H, information, b, T, se3.inv(T_start), tangents, gains, 1e-6)
    np.testing.assert_allclose(tangents[2], expected)
    np.testing.assert_allclose(T, before @ se3.exp(expected), atol=1e-12)
    np.testing.assert_allclose(tangents[0], se3.log(se3.inv(T_start) @ T), atol=1e-9)
    np.testing.assert_allclose(tangents[1], gains[0] * tangents[0], atol=1e-9)
    np.testing.assert_allclose([turned_rad, moved_m], [np.linalg.norm(expected[:3]), np.linalg.norm(expected[3:])])
    np.testing.assert_allclose(twisted_mps, np.linalg.norm((tangents[1] - twist) * gains[1]))


def test_the_equations_of_both_classes_are_the_sum_of_each_and_symmetric():
    rng = np.random.default_rng(20)
    surfs, corners = room(rng, 4000, 0.01)
    noise, T, sums = np.array([0.02, 1.5, 0.5]), se3.exp(rng.normal(0, 0.01, 6)), [np.zeros((6, 6)) for _ in range(2)]
    classes, b_sum, counted = [], np.zeros(6), np.zeros(3)
    for points, kind in ((corners, kernels.LINE), (surfs, kernels.PLANE)):
        voxels = VoxelMap(VoxelSettings(levels=2, min_points=5), kind)
        voxels.insert(points, 0)
        fits = np.empty((len(points), kernels.GEOMETRY))
        voxels.match(points, T, 0.5, fits)
        counted += equations.linearise(fits, points, T, noise, sums[0], b_sum)
        equations.spurious(fits, points, T, noise, sums[1])
        classes.append((fits, points))
    H, b, by_chance = np.full((6, 6), np.nan), np.full(6, np.nan), np.full((6, 6), np.nan)
    of_corners, of_surfs = classes
    assert equations.equations(of_corners, of_surfs, T, noise, H, b) == tuple(counted)
    equations.spurious_of_both(of_corners, of_surfs, T, noise, by_chance)
    assert counted[0] > 1000
    np.testing.assert_array_equal(b, b_sum)
    for whole, upper in ((H, sums[0]), (by_chance, sums[1])):
        np.testing.assert_array_equal(np.triu(whole), upper)
        np.testing.assert_array_equal(whole, whole.T)


def test_the_doubt_of_keyframes_is_carried_over_as_their_adjoints_say():
    rng = np.random.default_rng(21)
    here, poses = se3.exp(rng.normal(size=6)), np.array([se3.exp(rng.normal(size=6)) for _ in range(5)])
    roots = rng.normal(size=(5, 6, 6))
    covariances = roots @ roots.transpose(0, 2, 1)
    mean = np.empty((6, 6))
    doubts.carried_over(here, poses, covariances, mean)
    carries = [se3.adjoint(se3.inv(here) @ T) for T in poses]
    expected = np.mean([C @ P @ C.T for C, P in zip(carries, covariances, strict=True)], axis=0)
    np.testing.assert_allclose(mean, expected, rtol=1e-9, atol=1e-9)


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
