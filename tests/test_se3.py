"""Rigid transforms against the matrix exponential, from no angle at all to half a turn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from splitslam import se3

ANGLES_RAD = [0.0, 1e-9, 1e-7, 1e-5, 1e-4, 1e-3, 0.1, 1.0, 2.5, 3.1, np.pi - 1e-6, np.pi]


def tangents(angle_rad: float) -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    axes = [*np.eye(3), *-np.eye(3), *rng.normal(size=(6, 3))]
    return [np.concatenate([angle_rad * a / np.linalg.norm(a), rng.normal(0, 5, 3)]) for a in axes]


def matrix(xi: np.ndarray) -> np.ndarray:
    X = np.zeros((4, 4))
    X[:3, :3], X[:3, 3] = se3.hat(xi[:3]), xi[3:]
    return X


@pytest.mark.parametrize("angle_rad", ANGLES_RAD)
def test_exp_is_the_matrix_exponential_and_log_its_inverse(angle_rad: float):
    for xi in tangents(angle_rad):
        T = se3.exp(xi)
        np.testing.assert_allclose(T, expm(matrix(xi)), atol=1e-12)
        np.testing.assert_allclose(se3.so3_exp(xi[:3]), T[:3, :3], atol=1e-15)
        np.testing.assert_allclose(se3.exp(se3.log(T)), T, atol=1e-9)  # at half a turn there are two
        np.testing.assert_array_equal(se3.log(T)[:3], se3.so3_log(T[:3, :3]))
        if angle_rad < np.pi - 1e-9:
            np.testing.assert_allclose(se3.log(T), xi, atol=1e-8)


@pytest.mark.parametrize("angle_rad", ANGLES_RAD)
def test_quaternions_angles_inverses_and_adjoints(angle_rad: float):
    for xi in tangents(angle_rad):
        T = se3.exp(xi)
        q = se3.quat_from_matrix(T[:3, :3])
        assert q[3] >= 0
        assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)
        np.testing.assert_allclose(se3.matrix_from_quat(3.0 * q), T[:3, :3], atol=1e-12)
        assert se3.angle(T) == pytest.approx(angle_rad, abs=1e-7)
        np.testing.assert_allclose(se3.inv(T), np.linalg.inv(T), atol=1e-12)
        small = np.array([1e-3, -2e-3, 1e-3, 0.01, 0.02, -0.01])
        np.testing.assert_allclose(se3.exp(se3.adjoint(T) @ small), T @ se3.exp(small) @ se3.inv(T), atol=1e-11)


def test_between_two_poses_the_turn_is_steady_and_the_way_straight():
    A, step = se3.exp(np.array([0.3, -0.2, 1.0, 1.0, 2.0, 3.0])), np.array([0.2, 0.4, -0.6])
    B = A @ se3.compose(se3.so3_exp(step), np.array([1.0, 0.0, 0.0]))
    for ratio in (-0.5, 0.0, 0.3, 1.0, 1.5):
        T = se3.interpolate(A, B, ratio)
        np.testing.assert_allclose(T[:3, :3], A[:3, :3] @ se3.so3_exp(ratio * step), atol=1e-12)
        np.testing.assert_allclose(T[:3, 3], (1 - ratio) * A[:3, 3] + ratio * B[:3, 3], atol=1e-12)
    np.testing.assert_allclose(se3.orthonormalised(A + 1e-6), A, atol=2e-6)
