"""Poses of the last seconds by stamp."""

from __future__ import annotations

import numpy as np

from edge_agent.imu.history import PoseHistory
from splitslam import se3


def pose(x_m: float) -> np.ndarray:
    return np.hstack([np.eye(3), [[x_m], [0.0], [0.0]]]).reshape(1, 12)


def test_a_pose_is_found_between_two_and_held_beyond_them():
    history = PoseHistory(1000)
    np.testing.assert_array_equal(history.at(5), np.eye(4))
    for k in range(20):
        history.append(np.array([10 * k]), pose(float(k)))
    for stamp_ns, x_m in ((-5, 0.0), (0, 0.0), (4, 0.4), (10, 1.0), (185, 18.5), (190, 19.0), (900, 19.0)):
        assert abs(history.at(stamp_ns)[0, 3] - x_m) < 1e-12


def test_between_two_poses_the_rotation_goes_evenly():
    history, T = PoseHistory(1000), [se3.exp(np.array([0.1, 0.2, -0.3, 1.0, 2.0, 3.0])), se3.exp(np.full(6, 0.9))]
    history.append(np.array([100, 200]), np.array([pose[:3].reshape(12) for pose in T]))
    for stamp_ns, share in ((100, 0.0), (130, 0.3), (200, 1.0)):
        np.testing.assert_allclose(history.at(stamp_ns), se3.interpolate(T[0], T[1], share), atol=1e-12)


def test_what_is_older_than_it_keeps_is_forgotten():
    history = PoseHistory(1000)
    for k in range(20_000):
        history.append(np.array([10 * k]), pose(float(k)))
        assert len(history) <= 1024
        assert history.at(10 * k - 1000)[0, 3] == max(k - 100.0, 0.0)
    assert history.at(0)[0, 3] > 18_900.0
