"""How the doubt of the map grows: with new ground, not with scans; back on old ground it is what it was there."""

from __future__ import annotations

import numpy as np
import pytest

from map_service.drift import MapDrift
from splitslam import se3

STEP = np.diag(np.repeat([1e-6, 1e-4], 3))
NO_AXES = np.zeros((0, 6))


def poses(count: int) -> list[np.ndarray]:
    return [se3.compose(se3.so3_exp(np.array([0, 0, 0.1 * k])), np.array([float(k), 0.0, 0.0])) for k in range(count)]


def test_scans_on_the_same_ground_add_nothing():
    T = poses(2)
    drift = MapDrift([np.zeros((6, 6)), STEP])
    for _ in range(100):
        drift.follow(np.eye(4), NO_AXES, STEP)
        np.testing.assert_allclose(drift.at(T[1], np.array([1]), T.__getitem__), STEP, atol=1e-15)


def test_new_ground_adds_up_and_old_ground_is_as_good_as_it_was():
    T = poses(30)
    keyframes: list[np.ndarray] = [np.zeros((6, 6))]
    drift = MapDrift(keyframes)
    for k in range(1, 30):
        keyframes.append(drift.at(T[k], np.array([k - 1]), T.__getitem__) + STEP)
    far = drift.at(T[29], np.array([28]), T.__getitem__)
    assert far[0, 0] == pytest.approx(28e-6, rel=0.01)
    # the heading's error moves a robot that is far from where it arose
    assert far[4, 4] > 28e-4 + 1e-6 * 29**3 / 6
    np.testing.assert_allclose(drift.at(T[0], np.array([0, 0]), T.__getitem__), 0.0)


def test_the_map_near_the_robot_is_off_like_a_rigid_body():
    T_keyframe = se3.exp(np.array([0.1, 0.2, 0.3, 5.0, -2.0, 1.0]))
    T = se3.exp(np.array([-0.2, 0.1, 1.0, 9.0, 3.0, 1.5]))
    rng = np.random.default_rng(2)
    covariance = np.diag(rng.uniform(1e-7, 1e-6, 6))
    errors = rng.multivariate_normal(np.zeros(6), covariance, 4000)
    moved = []
    for xi in errors:  # the map with keyframe and robot in it is moved so that the keyframe is off by xi
        wrong = T_keyframe @ se3.exp(xi) @ se3.inv(T_keyframe)
        moved.append(se3.log(se3.inv(T) @ wrong @ T))
    told = MapDrift([covariance]).at(T, np.array([0]), [T_keyframe].__getitem__)
    np.testing.assert_allclose(np.cov(np.array(moved).T), told, atol=0.1 * np.abs(told).max())


def test_what_is_not_observed_is_doubted_more_with_every_scan_and_only_there():
    along = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    drift = MapDrift([np.zeros((6, 6))])
    for _ in range(50):
        drift.follow(se3.compose(np.eye(3), np.array([0.5, 0.0, 0.0])), along, np.eye(6) * 0.01**2)
    assert np.sqrt(drift.slip[3, 3]) == pytest.approx(50 * 0.01)  # a velocity is wrong the same way all the time
    assert np.count_nonzero(drift.slip) == 1
    drift.follow(np.eye(4), NO_AXES, STEP)
    assert not drift.slip.any()
