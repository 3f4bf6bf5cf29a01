"""The equations of a registration, their solution and the doubt of keyframes, each against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam import se3
from splitslam.registration import _doubt_kernels as doubts
from splitslam.registration import _equation_kernels as equations
from splitslam.registration import _kernels as kernels
from splitslam.registration.local_map import VoxelMap
from splitslam.registration.settings import VoxelSettings
from tests.map_pipeline.naive import equation_fits, normal_equations, room
from tests.map_pipeline.test_local_map import PLANES


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
    expected_H, expected_b = normal_equations(lidar[hit], T, equation_fits(g), noise)
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
