from __future__ import annotations

import numpy as np
import pytest

from splitslam import se3
from splitslam.registration.align import Prediction, Registration, deskew_again
from splitslam.registration.local_map import LocalMap
from splitslam.registration.settings import LocalMapSettings, RegistrationSettings
from tests.map_pipeline.naive import room

WEAK = np.diag(1 / np.repeat([0.1**2, 0.3**2], 3))


def made_map(rng: np.random.Generator) -> LocalMap:
    surfs, corners = room(rng, 12_000, 0.02)
    local_map = LocalMap(LocalMapSettings())
    local_map.insert(0, np.eye(4), corners.astype(np.float32), surfs.astype(np.float32))
    return local_map


def seen_from(T: np.ndarray, rng: np.random.Generator, count: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    surfs, corners = room(rng, count, 0.02)
    back = se3.inv(T)
    return tuple((p @ back[:3, :3].T + back[:3, 3]).astype(np.float32) for p in (corners, surfs))  # type: ignore[return-value]


def align(local_map, corners, surfs, T_guess, *, velocity_sigma=0.1, again=False, times=None, information=WEAK):
    registration = Registration(RegistrationSettings())
    times = times or (np.zeros(len(corners)), np.zeros(len(surfs)))
    return registration.align(
        local_map, corners, surfs, times, Prediction(T_guess, information, 0.1, 1e-3, np.full(3, velocity_sigma)), again
    )


@pytest.mark.parametrize("off", [[0, 0, 0, 0, 0, 0], [0.02, -0.01, 0.05, 0.15, -0.1, 0.05], [0, 0, 0.1, -0.3, 0.2, 0]])
def test_a_scan_of_the_mapped_room_is_placed_to_millimetres(off):
    rng = np.random.default_rng(7)
    local_map = made_map(rng)
    T = se3.exp(np.array([0.01, 0.02, 0.8, 0.7, -0.5, 1.2]))
    corners, surfs = seen_from(T, rng)
    result = align(local_map, corners, surfs, T @ se3.exp(np.array(off, float)), velocity_sigma=1.0)
    error = se3.log(se3.inv(T) @ result.T_local_lidar)
    assert result.converged
    assert np.linalg.norm(error[3:]) < 0.006
    assert np.linalg.norm(error[:3]) < 0.002
    assert result.inliers > 0.8 * result.features
    assert len(result.degenerate_axes) == 0
    # the covariance means something: the error is within it
    assert error @ np.linalg.inv(result.covariance) @ error < 25


def test_between_two_parallel_walls_the_free_direction_is_named_and_left_to_the_prediction():
    rng = np.random.default_rng(8)

    def corridor(n: int) -> np.ndarray:
        walls = np.column_stack([rng.uniform(-30, 30, n), rng.choice([-1.5, 1.5], n), rng.uniform(0, 2.5, n)])
        floor = np.column_stack([rng.uniform(-30, 30, n), rng.uniform(-1.5, 1.5, n), np.zeros(n)])
        return np.concatenate([walls, floor]) + rng.normal(0, 0.02, (2 * n, 3))

    local_map = LocalMap(LocalMapSettings())
    none = np.zeros((0, 3), np.float32)
    local_map.insert(0, np.eye(4), none, corridor(40_000).astype(np.float32))
    scan = corridor(800).astype(np.float32)
    guess = se3.exp(np.array([0, 0, 0, 0.10, 0.05, 0.0]))
    result = align(local_map, none, scan, guess)
    assert result.T_local_lidar[0, 3] == pytest.approx(0.10, abs=0.02)  # along: as predicted
    assert result.T_local_lidar[1, 3] == pytest.approx(0.0, abs=0.01)  # across: registered
    assert len(result.degenerate_axes) == 1
    assert abs(result.degenerate_axes[0] @ [0, 0, 0, 1, 0, 0]) > 0.95
    assert np.sqrt(result.covariance[3, 3]) > 0.05


def test_a_wrong_velocity_is_found_and_the_scan_deskewed_again():
    rng = np.random.default_rng(9)
    local_map = made_map(rng)
    T = se3.exp(np.array([0, 0, 0.3, 0.5, 0.2, 1.0]))
    corners, surfs = seen_from(T, rng, 3000)
    truth = np.array([2.0, -1.0, 0.0])  # velocity that the edge did not know of
    times = rng.uniform(0, 0.1, len(corners)), rng.uniform(0, 0.1, len(surfs))
    corners, surfs = ((p - t[:, None] * truth).astype(np.float32) for p, t in zip((corners, surfs), times, strict=True))
    guess = T @ se3.exp(np.concatenate([np.zeros(3), -truth * 0.1]))  # the prediction misses it as well
    again = align(
        local_map, corners, surfs, guess, velocity_sigma=10.0, again=True, times=times, information=WEAK * 1e-4
    )
    once = align(
        local_map, corners, surfs, guess, velocity_sigma=10.0, again=False, times=times, information=WEAK * 1e-4
    )
    np.testing.assert_allclose(again.delta_twist[3:], truth, atol=0.15)
    assert np.linalg.norm((se3.inv(T) @ again.T_local_lidar)[:3, 3]) < 0.01
    assert np.linalg.norm((se3.inv(T) @ once.T_local_lidar)[:3, 3]) > 0.05


def test_deskewing_again_is_first_order_in_the_twist():
    rng = np.random.default_rng(10)
    points, times = rng.uniform(-20, 20, (50, 3)), rng.uniform(0, 0.1, 50)
    twist = np.array([0.02, -0.01, 0.03, 0.3, 0.1, -0.2])
    moved = deskew_again(points, times, twist)
    exact = np.stack(
        [se3.exp(twist * t)[:3, :3] @ p + se3.exp(twist * t)[:3, 3] for p, t in zip(points, times, strict=True)]
    )
    assert np.abs(moved - exact).max() < 2e-4
    assert np.abs(moved - points).max() > 0.02
