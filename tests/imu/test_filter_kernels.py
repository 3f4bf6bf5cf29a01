"""The filter's kernels against plain numpy."""

from __future__ import annotations

import numpy as np

from edge_agent.imu import _filter_kernels as kernels
from edge_agent.imu._kernels import integrate
from splitslam import se3

G = 9.80665


def some_covariance(rng: np.random.Generator, size: int) -> np.ndarray:
    root = rng.normal(size=(size, size))
    return root @ root.T / size


def test_rows_taken_one_after_the_other_are_the_textbook_s_update_at_once():
    rng = np.random.default_rng(1)
    P, H, r, known = some_covariance(rng, 21), rng.normal(size=(6, 21)), rng.normal(size=6), rng.normal(0, 0.1, 21)
    S = H @ P @ H.T + 0.3 * np.eye(6)
    K = P @ H.T @ np.linalg.inv(S)
    got, change = P.copy(), known.copy()
    kernels.measure(H, r, 0.3, got, change)
    np.testing.assert_allclose(change, known + K @ (-r - H @ known), atol=1e-9)
    np.testing.assert_allclose(got, P - K @ S @ K.T, atol=1e-9)


def wobble(seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, gyro, accel of 200 Hz."""
    t = np.arange(0.0, seconds + 1e-9, 0.005)
    gyro = np.stack([np.sin(3 * t), 0.5 * np.cos(2 * t), 0.7 * np.sin(5 * t)], axis=1)
    accel = np.stack([2 * np.cos(4 * t), np.sin(3 * t), G + np.sin(2 * t)], axis=1)
    return 1_700_000_000_000_000_000 + (t * 1e9).astype(np.int64), gyro, accel


def moved(row: np.ndarray, bias: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    R = se3.so3_exp(error[:3]) @ row[:9].reshape(3, 3)
    return np.concatenate([R.reshape(-1), row[9:] + error[3:9]]), bias + error[9:15]


def test_the_covariance_goes_as_the_derivatives_of_the_integration_say():
    rng = np.random.default_rng(2)
    stamps, gyro, accel = wobble(0.1)
    first = np.concatenate([se3.so3_exp(rng.normal(size=3)).reshape(-1), rng.normal(size=6)])
    bias = rng.normal(0, 0.05, 6)

    def run(error: np.ndarray) -> np.ndarray:
        states = np.empty((len(stamps), 15))
        states[0], wrong = moved(first, bias, error)
        integrate(stamps, gyro, accel, wrong, G, states)
        return states

    right = run(np.zeros(15))

    def end(error: np.ndarray) -> np.ndarray:
        last = run(error)[-1]
        turned = se3.so3_log(last[:9].reshape(3, 3) @ right[-1, :9].reshape(3, 3).T)
        return np.concatenate([turned, last[9:] - right[-1, 9:], error[9:]])

    h = 1e-5
    F = np.eye(22)
    F[:15, :15] = np.column_stack([(end(h * e) - end(-h * e)) / (2 * h) for e in np.eye(15)])
    P = some_covariance(rng, 22)
    got = P.copy()
    error = rng.normal(size=(22, 1))
    carried = error.copy()
    kernels.carry(stamps, right, G, np.zeros(3), 10_000_000, got, carried)
    np.testing.assert_allclose(got, F @ P @ F.T, atol=1e-4)
    np.testing.assert_allclose(carried, F @ error, atol=1e-4)
    np.testing.assert_allclose(got, got.T, atol=1e-12)


def test_a_state_goes_on_as_the_imu_says_and_takes_its_covariance_along():
    rng = np.random.default_rng(3)
    stamps, gyro, accel = wobble(0.1)
    poses, rest = np.array([some_pose(rng), some_pose(rng)]), rng.normal(0, 0.05, 10)
    P, error, T_server_imu = some_covariance(rng, 22), rng.normal(size=22), some_pose(rng)
    variances = rng.uniform(1e-8, 1e-4, 8)
    states = np.empty((len(stamps), 15))
    states[0] = np.concatenate([poses[0, :3, :3].reshape(-1), poses[0, :3, 3], rest[:3]])
    integrate(stamps, gyro, accel, rest[3:9], G, states)
    expected, carried = P.copy(), error[:, None].copy()
    kernels.carry(stamps, states, G, variances[:3], 10_000_000, expected, carried)
    kernels.disturb(expected, T_server_imu, variances[3:] * 0.1)
    to_poses, to_rest = poses.copy(), rest.copy()
    kernels.predict((stamps, gyro, accel), T_server_imu, G, variances, to_poses, to_rest, P, error)
    np.testing.assert_allclose(to_poses[0], se3.compose(states[-1, :9].reshape(3, 3), states[-1, 9:12]), atol=1e-9)
    np.testing.assert_allclose(to_poses[1], poses[1])
    np.testing.assert_allclose(to_rest, [*states[-1, 12:], *rest[3:]], atol=1e-12)
    np.testing.assert_allclose(P, expected, atol=1e-12)
    np.testing.assert_allclose(error, carried[:, 0], atol=1e-12)


def test_noise_of_gyro_and_accelerometer_shows_in_velocity_and_position():
    stamps, _, _ = wobble(1.0)
    level = np.concatenate([np.eye(3).reshape(-1), np.zeros(6)])
    states = np.tile(level, (len(stamps), 1))
    P = np.zeros((21, 21))
    kernels.carry(stamps, states, G, np.array([1e-6, 0.0, 1e-4]), 10_000_000, P, np.zeros((21, 1)))
    tilted = 1e-6 * G**2 / 3  # velocity's variance after a second of a tilt that wanders
    expected = [1e-6, 1e-6, 1e-6, 1e-4 + tilted, 1e-4 + tilted, 1e-4]
    np.testing.assert_allclose(np.diag(P)[[0, 1, 2, 6, 7, 8]], expected, rtol=0.01)
    np.testing.assert_allclose(P[5, 5], 1e-4 / 3, rtol=0.01)


def some_pose(rng: np.random.Generator) -> np.ndarray:
    return se3.exp(np.concatenate([rng.normal(0, 1.0, 3), rng.normal(0, 5.0, 3)]))


def moved_state(poses: np.ndarray, rest: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    to_poses, to_rest = np.empty((2, 4, 4)), np.empty(10)
    kernels.move(poses, rest, change, to_poses, to_rest)
    return to_poses, to_rest


def test_an_error_taken_out_turns_and_shifts_the_imu_in_odom_and_the_server_in_its_own_frame():
    rng = np.random.default_rng(4)
    for size, turn in ((21, 1e-9), (22, 0.4)):
        poses, rest = np.array([some_pose(rng), some_pose(rng)]), rng.normal(size=10)
        change = rng.normal(size=size)
        change[:3] *= turn
        to_poses, to_rest = moved_state(poses, rest, change)
        np.testing.assert_allclose(to_poses[0, :3, :3], se3.so3_exp(change[:3]) @ poses[0, :3, :3], atol=1e-12)
        np.testing.assert_allclose(to_poses[0, :3, 3], poses[0, :3, 3] + change[3:6], atol=1e-12)
        np.testing.assert_allclose(to_poses[1], poses[1] @ se3.exp(change[15:21]), atol=1e-12)
        np.testing.assert_allclose(to_poses[:, 3], [[0, 0, 0, 1]] * 2)
        np.testing.assert_allclose(to_rest[:9], rest[:9] + change[6:15], atol=1e-12)
        np.testing.assert_allclose(to_rest[9], rest[9] + (change[21] if size == 22 else 0.0))


def test_the_residual_of_a_pose_is_what_is_left_of_it_and_goes_as_its_derivatives_say():
    rng = np.random.default_rng(5)
    T_odom_imu, T_odom_server = some_pose(rng), some_pose(rng)
    left = se3.exp(rng.normal(0, 0.01, 6))
    T_server_imu = se3.inv(T_odom_server) @ T_odom_imu @ se3.inv(left)
    poses, rest, whiten = np.array([T_odom_imu, T_odom_server]), np.zeros(10), rng.normal(size=(6, 6))

    def residual(change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r, H = np.empty(6), np.empty((6, 27))
        kernels.pose_residual(moved_state(poses, rest, change)[0], T_server_imu, whiten, r, H)
        return r, H

    r, H = residual(np.zeros(21))
    np.testing.assert_allclose(r, whiten @ [*se3.so3_log(left[:3, :3]), *left[:3, 3]], atol=1e-9)
    h = 1e-6
    numeric = np.column_stack([(residual(h * e)[0] - residual(-h * e)[0]) / (2 * h) for e in np.eye(21)])
    np.testing.assert_allclose(H[:, :21], numeric, atol=0.05)  # a residual of 0.01 rad bends them by as much
    assert np.abs(H[:, 6:15]).max() == 0.0
    assert np.abs(H[:, 21:]).max() == 0.0
    r, H = residual(np.concatenate([np.zeros(3), [0.01, 0.02, -0.01], np.zeros(15)]))
    assert np.linalg.norm(r) > 0.01


def test_what_wanders_by_itself_is_added_where_it_is():
    rng = np.random.default_rng(6)
    for size, scale in ((21, 0.0), (22, 3e-7), (27, 0.0)):
        before, T, variances = some_covariance(rng, size), some_pose(rng), rng.uniform(1e-6, 1e-3, 5)
        variances[2] = scale
        expected = before.copy()
        expected[9:15, 9:15] += np.diag(np.repeat(variances[:2], 3))
        if scale:
            expected[21, 21] += scale
        to_server = se3.adjoint(T)
        expected[15:21, 15:21] += to_server @ np.diag(np.repeat(variances[3:], 3)) @ to_server.T
        kernels.disturb(before, T, variances)
        np.testing.assert_allclose(before, expected, atol=1e-12)
