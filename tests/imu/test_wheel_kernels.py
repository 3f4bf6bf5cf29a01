from __future__ import annotations

import numpy as np

from edge_agent.imu import _wheel_kernels as kernels
from splitslam import se3
from tests.imu.test_kernels import naive_integrate, random_motion

GEOMETRY = np.column_stack([se3.so3_exp(np.array([0.1, -0.2, 1.2])), [0.3, -0.4, 0.5]])
NOISE = np.array([1e-4, 9e-4, 5.0, 0.3])


def gentle_motion(count: int = 40):
    stamps, gyro, accel, bias, first = random_motion(count)
    return stamps, 0.3 * gyro, 0.3 * accel + [0, 0, 9.81], bias, first


def readings_of(states, times_s, rates, at, rng):
    """Rows at the states `at`: what is true there, a little wrong, every third one grossly; some axes not measured."""
    rows = np.empty((len(at), 10))
    for row, k in zip(rows, at, strict=True):
        R, v = states[k, :9].reshape(3, 3), states[k, 12:]
        row[0] = times_s[k]
        row[1:4] = GEOMETRY[:, :3] @ (R.T @ v + np.cross(rates[k], GEOMETRY[:, 3])) + rng.normal(0, 0.05, 3)
        row[4:7], row[7:] = 0.01, 0.04
    rows[::3, 1] += 30.0
    rows[1::4, 9] = -1.0
    return rows


def naive_aid(stamps, gyro, accel, bias, first, readings, P):
    """The filter as one would write it: integrate a step, then correct, then go on from there."""
    rows, P = [first.copy()], P.copy()
    times_s = (stamps - stamps[0]) * 1e-9
    for k in range(len(stamps)):
        if k:
            rows.append(naive_integrate(stamps[k - 1 : k + 1], gyro[k - 1 : k + 1], accel[k - 1 : k + 1], bias, 9.81,
                                        rows[-1])[1])  # fmt: skip
            age = NOISE[3] + times_s[k]
            P = P + np.eye(3) * (NOISE[0] + 2 * NOISE[1] * min(age, NOISE[2])) * (times_s[k] - times_s[k - 1])
        for reading in readings[readings[:, 0] == times_s[k]]:
            for a in range(3):
                if reading[7 + a] < 0:
                    continue
                R, v = rows[-1][:9].reshape(3, 3), rows[-1][12:]
                H = GEOMETRY[a, :3] @ R.T
                there = H @ v + GEOMETRY[a, :3] @ np.cross(gyro[k] - bias[:3], GEOMETRY[:, 3])
                innovation = reading[1 + a] - there
                if innovation**2 > 9 * (H @ P @ H + reading[4 + a]):
                    continue
                K = P @ H / (H @ P @ H + reading[7 + a])
                rows[-1][12:] = v + K * innovation
                P = P - np.outer(K, H @ P)
    return np.array(rows), P


def test_the_filter_equals_its_naive_twin():
    stamps, gyro, accel, bias, first = gentle_motion()
    states = naive_integrate(stamps, gyro, accel, bias, 9.81, first)
    times_s, rates = (stamps - stamps[0]) * 1e-9, gyro - bias[:3]
    readings = readings_of(states, times_s, rates, [0, 3, 3, 10, 22, 30, 39], np.random.default_rng(3))
    first = first.copy()
    first[12:] += [0.3, -0.2, 0.1]  # the wheels have something to correct
    aided = naive_integrate(stamps, gyro, accel, bias, 9.81, first)
    P = np.diag([0.3, 0.2, 0.1])
    expected, P_expected = naive_aid(stamps, gyro, accel, bias, first, readings, P)
    assert np.abs(expected - aided).max() > 0.05
    kernels.aid(times_s, rates, aided, readings, GEOMETRY, NOISE, P)
    np.testing.assert_allclose(aided, expected, atol=1e-9)
    np.testing.assert_allclose(P, P_expected, atol=1e-12)


def test_a_reading_between_two_states_is_compared_with_the_velocity_there():
    stamps, gyro, accel, bias, first = random_motion(3)
    gyro, accel = np.tile(0.2 * gyro[:1], (401, 1)), np.tile(0.5 * accel[:1], (401, 1)) + [0, 0, 9.81]
    stamps = stamps[0] + np.arange(401, dtype=np.int64) * 100_000
    fine = naive_integrate(stamps, gyro, accel, bias, 9.81, first)
    times_s, rates = (stamps - stamps[0]) * 1e-9, gyro - bias[:3]
    coarse = [0, 200, 400]
    at = readings_of(fine, times_s, rates, [137, 333], np.random.default_rng(0))
    at[0, 1] -= 30.0
    difference, exact = np.empty((2, 3)), np.empty((2, 3))
    kernels.innovations(times_s[coarse], rates[coarse], fine[coarse], at, GEOMETRY, difference)
    kernels.innovations(times_s, rates, fine, at, GEOMETRY, exact)
    assert np.abs(exact).max() < 0.2
    np.testing.assert_allclose(difference, exact, atol=2e-4)


def test_the_speed_of_a_state_is_that_of_the_wheel_s_origin():
    _, gyro, _, _, first = random_motion(3)
    out = np.empty(3)
    kernels.speed(first, np.zeros(4), gyro[0], GEOMETRY, out)
    R, v = first[:9].reshape(3, 3), first[12:]
    np.testing.assert_allclose(out, GEOMETRY[:, :3] @ (R.T @ v + np.cross(gyro[0], GEOMETRY[:, 3])), atol=1e-12)
