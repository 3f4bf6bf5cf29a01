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


def naive_follow(stamps, wanted, limits, lever, first):
    tau, rate_rad, rate_m, step_rad, step_m = limits
    output, worst = [first], np.zeros(2)
    L = se3.compose(np.eye(3), lever)
    for k in range(1, len(stamps)):
        dt = (stamps[k] - stamps[k - 1]) * 1e-9
        moved = output[-1] @ se3.inv(wanted[k - 1]) @ wanted[k]
        error = se3.inv(moved) @ wanted[k]
        turn, shift = se3.so3_log(error[:3, :3]), error[:3, 3]
        angle, distance = np.linalg.norm(turn), np.linalg.norm(shift)
        share = 1 - np.exp(-dt / tau)
        turn = turn * min(angle * share, rate_rad * dt, step_rad) / max(angle, 1e-12)
        shift = shift * min(distance * share, rate_m * dt, step_m) / max(distance, 1e-12)
        step = se3.compose(se3.so3_exp(turn), shift)
        output.append(moved @ step)
        worst = np.maximum(worst, [np.linalg.norm((se3.inv(L) @ step @ L)[:3, 3]), np.linalg.norm(turn)])
    return output, worst


def followed(wanted, stamps, limits, first, lever=(0.3, -0.2, 0.1)):
    rows = np.array([T[:3].reshape(-1) for T in wanted])
    output, worst = np.empty_like(rows), np.zeros(2)
    output[0] = first[:3].reshape(-1)
    kernels.follow(stamps, rows, np.array(limits), np.array(lever), output, worst)
    return output.reshape(-1, 3, 4), worst


def states_as_matrices(count: int = 40):
    stamps, gyro, accel, bias, first = random_motion(count)
    states = naive_integrate(stamps, gyro, accel, bias, 9.81, first)
    return stamps, states, [se3.compose(s[:9].reshape(3, 3), s[9:12]) for s in states]


def test_the_output_follows_as_its_naive_twin_does():
    stamps, _, wanted = states_as_matrices()
    first = wanted[0] @ se3.exp(np.array([0.02, -0.01, 0.03, 0.2, 0.1, -0.3]))
    for limits in ((0.3, 0.05, 0.1, 1e-3, 2e-4), (0.05, 1e3, 1e3, 1e3, 1e3)):
        output, worst = followed(wanted, stamps, limits, first)
        naive, naive_worst = naive_follow(stamps, wanted, limits, np.array([0.3, -0.2, 0.1]), first)
        np.testing.assert_allclose(output, np.array(naive)[:, :3], atol=1e-9)
        np.testing.assert_allclose(worst, naive_worst, atol=1e-9)


def test_a_large_correction_of_a_fast_robot_steps_no_more_than_it_may():
    # 10 Hz at 20 m/s, 6 degrees and 2 m off: a correction must turn neither the increments nor the way ahead
    stamps = np.arange(0, 30_000_000_000, 100_000_000)
    wanted = [se3.compose(se3.so3_exp(np.array([0, 0, 0.02 * k])), np.array([2.0 * k, 0, 0])) for k in range(300)]
    first = wanted[0] @ se3.exp(np.array([0.1, 0, 0, 0, 2.0, 0]))
    output, worst = followed(wanted, stamps, (0.3, 0.05, 0.1, 0.003, 0.01), first)
    error = [se3.inv(T) @ se3.compose(o[:, :3], o[:, 3]) for T, o in zip(wanted, output, strict=True)]
    assert worst[0] <= 0.01 + 0.003 * 0.4
    assert worst[1] <= 0.003 + 1e-12
    assert se3.angle(error[-1]) < 1e-4
    assert np.linalg.norm(error[-1][:3, 3]) < 0.01


def test_poses_are_those_of_the_states_times_the_extrinsics():
    _, states, wanted = states_as_matrices(8)
    T_imu_lidar = se3.exp(np.array([0.1, 0.2, 0.3, 1, 2, 3]))
    imu_poses, poses = np.empty((2, 8, 12))
    kernels.place(states, imu_poses)
    kernels.emit(imu_poses, T_imu_lidar, poses)
    np.testing.assert_allclose(poses.reshape(8, 3, 4), [(T @ T_imu_lidar)[:3] for T in wanted], atol=1e-12)


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


def test_a_window_has_the_samples_inside_it_and_its_marks_between_them_or_held():
    rng = np.random.default_rng(9)
    own_ns = np.cumsum(rng.integers(1, 9, 30)).astype(np.int64)
    values = rng.normal(size=(30, 6))
    for marks_ns in np.sort(rng.integers(-20, 180, (600, 4))):
        start_ns, end_ns = marks_ns[[0, -1]]
        inside = (own_ns > start_ns) & (own_ns < end_ns)
        first = int(np.searchsorted(own_ns, start_ns, side="right"))
        n = int(inside.sum()) + len(marks_ns)
        stamps_ns, gyro, accel = np.empty(n, np.int64), np.empty((n, 3)), np.empty((n, 3))
        count = kernels.window(own_ns, values, first, marks_ns, stamps_ns, gyro, accel)
        assert stamps_ns[:count].tolist() == np.union1d(marks_ns, own_ns[inside]).tolist()
        expected = np.stack([np.interp(stamps_ns[:count], own_ns, values[:, c]) for c in range(6)], axis=1)
        np.testing.assert_allclose(np.hstack([gyro, accel])[:count], expected, atol=1e-12)


def test_the_output_leads_on_from_where_it_was_as_its_parts_say():
    stamps, gyro, accel, bias, first = random_motion()
    states = np.empty((len(stamps), 15))
    states[0] = first
    kernels.integrate(stamps, gyro, accel, bias, 9.81, states)
    limits, T_imu_lidar = np.array([0.3, 0.05, 0.1, 0.003, 0.01]), se3.exp(np.array([0.1, 0.2, -0.3, 0.4, -0.1, 0.2]))
    wanted, output, expected = np.empty((3, len(stamps), 12))
    here, worst, poses, raised = (
        se3.exp(np.full(6, 0.1))[:3].flatten(),
        np.zeros(2),
        np.empty((len(stamps), 12)),
        np.zeros(2),
    )
    output[0] = here
    kernels.place(states, wanted)
    kernels.follow(stamps, wanted, limits, T_imu_lidar[:3, 3].copy(), output, raised)
    kernels.emit(output, T_imu_lidar, expected)
    kernels.lead(stamps, states, limits, T_imu_lidar, here, worst, poses)
    np.testing.assert_allclose(poses, expected, atol=1e-12)
    np.testing.assert_allclose(here, output[-1], atol=1e-12)
    np.testing.assert_allclose(worst, raised, atol=1e-12)


def test_the_motion_of_a_scan_is_from_one_state_to_another_and_on_from_there():
    stamps, gyro, accel, bias, first = random_motion()
    states = np.empty((len(stamps), 15))
    states[0] = first
    kernels.integrate(stamps, gyro, accel, bias, 9.81, states)
    T_imu_lidar = se3.exp(np.array([0.1, 0.2, -0.3, 0.4, -0.1, 0.2]))
    T = [se3.compose(row[:9].reshape(3, 3), row[9:12]) @ T_imu_lidar for row in states]
    T_prev_lidar, poses = np.eye(4), np.empty((len(stamps) - 25, 12))
    kernels.scan_motion(states, 7, 25, T_imu_lidar, T_prev_lidar, poses)
    np.testing.assert_allclose(T_prev_lidar, np.linalg.inv(T[7]) @ T[25], atol=1e-9)
    np.testing.assert_allclose(poses.reshape(-1, 3, 4), np.array(T)[25:, :3], atol=1e-12)


def naive_quietest(values, period_s, longest_s):
    densities = np.full(2, np.inf)
    count = 1
    while count == 1 or (count * period_s <= longest_s and len(values) >= 12 * count):
        whole = len(values) // count * count
        means = values[-whole:].reshape(-1, count, 6).mean(axis=1)
        rough = means[1:-1] - 0.5 * (means[:-2] + means[2:])
        variance = np.mean(rough**2, axis=0) / 1.5 * period_s * count
        densities = np.minimum(densities, np.sqrt([variance[:3].mean(), variance[3:].mean()]))
        count *= 2
    return densities


def test_the_quietest_block_length_equals_its_naive_twin():
    rng = np.random.default_rng(2)
    for samples, rate_hz in ((12, 10.0), (53, 100.0), (499, 500.0)):
        values = rng.normal(size=(samples, 6)) + np.sin(np.arange(samples) * 1.3)[:, None]
        densities = np.empty(2)
        kernels.quietest(values, 1.0 / rate_hz, 0.05, densities)
        np.testing.assert_allclose(densities, naive_quietest(values, 1.0 / rate_hz, 0.05), rtol=1e-12)
