from __future__ import annotations

import numpy as np

from edge_agent.imu import _kernels as kernels
from splitslam import se3


def naive_integrate(stamps, gyro, accel, bias, g, first):
    rows = [first]
    for k in range(1, len(stamps)):
        dt = (stamps[k] - stamps[k - 1]) * 1e-9
        R, p, v = rows[-1][:9].reshape(3, 3), rows[-1][9:12], rows[-1][12:]
        new = R @ se3.so3_exp((0.5 * (gyro[k] + gyro[k - 1]) - bias[:3]) * dt)
        a = 0.5 * (R @ (accel[k - 1] - bias[3:]) + new @ (accel[k] - bias[3:])) - np.array([0, 0, g])
        rows.append(np.concatenate([new.reshape(-1), p + v * dt + 0.5 * a * dt**2, v + a * dt]))
    return np.array(rows)


def random_motion(count: int = 60):
    rng = np.random.default_rng(1)
    stamps = 1_700_000_000_000_000_000 + np.cumsum(rng.integers(1_000_000, 9_000_000, count))
    first = np.concatenate([se3.so3_exp(rng.normal(size=3)).reshape(-1), rng.normal(size=6)])
    return stamps, rng.normal(size=(count, 3)), rng.normal(0, 3, (count, 3)), rng.normal(0, 0.1, 6), first


def test_integration_equals_its_naive_twin():
    stamps, gyro, accel, bias, first = random_motion()
    states = np.empty((len(stamps), 15))
    states[0] = first
    kernels.integrate(stamps, gyro, accel, bias, 9.81, states)
    np.testing.assert_allclose(states, naive_integrate(stamps, gyro, accel, bias, 9.81, first), atol=1e-10)


def test_emitted_poses_are_state_times_offset_times_extrinsics():
    stamps, gyro, accel, bias, first = random_motion(8)
    states = naive_integrate(stamps, gyro, accel, bias, 9.81, first)
    offsets = np.random.default_rng(2).normal(0, 0.1, (8, 6))
    T_imu_lidar = se3.exp(np.array([0.1, 0.2, 0.3, 1, 2, 3]))
    poses = np.empty((8, 12))
    kernels.emit(states, offsets, T_imu_lidar, poses)
    for s, o, pose in zip(states, offsets, poses, strict=True):
        T = se3.compose(s[:9].reshape(3, 3), s[9:12]) @ se3.compose(se3.so3_exp(o[:3]), o[3:]) @ T_imu_lidar
        np.testing.assert_allclose(pose.reshape(3, 4), T[:3], atol=1e-12)


def test_an_offset_fades_no_faster_than_allowed_and_to_nothing():
    stamps = np.arange(0, 5_000_000_000, 5_000_000)
    offsets = np.empty((len(stamps), 6))
    kernels.blend(stamps, np.array([0.02, 0, 0, 0.3, 0, 0.4]), np.array([0.3, 0.05, 0.1]), offsets)
    rates = np.abs(np.diff(np.linalg.norm(offsets[:, 3:], axis=1))) / 0.005
    assert rates.max() <= 0.1 + 1e-9
    assert np.abs(np.diff(np.linalg.norm(offsets[:, :3], axis=1))).max() / 0.005 <= 0.05 + 1e-9
    assert np.linalg.norm(offsets[-1, :3]) < 1e-6
    assert np.linalg.norm(offsets[0, 3:]) == 0.5
    assert (np.diff(np.linalg.norm(offsets, axis=1)) <= 0).all()


def test_steps_measures_what_the_output_adds_to_the_imu_s_own_motion():
    stamps, gyro, accel, bias, first = random_motion(5)
    states = naive_integrate(stamps, gyro, accel, bias, 9.81, first)
    offsets = np.zeros((5, 6))
    offsets[3:, 3] = 0.04
    poses, worst = np.empty((5, 12)), np.zeros(2)
    kernels.emit(states, offsets, np.eye(4), poses)
    kernels.steps(states, poses, np.eye(4), worst)
    # one step of 4 cm, and the lever of the last rotation on the offset that stays
    assert 0.039 < worst[0] < 0.05
    assert worst[1] < 1e-6


def test_quaternions_positions_and_knots_are_those_of_the_poses():
    rng = np.random.default_rng(3)
    T = [se3.exp(np.concatenate([rng.normal(0, 1.5, 3), rng.normal(size=3)])) for _ in range(50)]
    T[7] = se3.exp(np.array([np.pi, 0, 0, 0, 0, 0]))  # half a turn: the branch without a trace
    poses = np.array([t[:3].reshape(-1) for t in T])
    positions, quats = np.empty((50, 3)), np.empty((50, 4))
    kernels.split(poses, positions, quats)
    for t, p, q in zip(T, positions, quats, strict=True):
        np.testing.assert_allclose(se3.from_quat(p, q), t, atol=1e-12)
        assert q[3] >= 0
    rotation, translation = np.empty((50, 3)), np.empty((50, 3))
    kernels.knots(poses, rotation, translation)
    for t, w, p in zip(T, rotation, translation, strict=True):
        np.testing.assert_allclose(se3.compose(se3.so3_exp(w), p), se3.inv(T[0]) @ t, atol=1e-9)
