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
