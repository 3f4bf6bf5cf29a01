"""An IMU that is silent for a while: what stands in for its samples, and what the node makes of it."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.imu import _kernels as kernels
from edge_agent.imu.gaps import Gaps, carried_on
from splitslam import se3
from splitslam.scan import ImuSamples
from tests.imu.made import SCAN_NS, START_NS, Drive, make_node, play

MS = 1_000_000
G = 9.80665


@pytest.mark.parametrize(("rate_hz", "longest_ms"), [(500.0, 50), (100.0, 50), (10.0, 500)])
def test_what_is_a_gap_goes_by_the_rate_that_is_seen_not_by_the_one_that_is_stated(rate_hz, longest_ms):
    gaps = Gaps(100.0)
    gaps.seen(np.arange(60) * int(1e9 / rate_hz))
    last_ns = 59 * int(1e9 / rate_hz)
    assert not gaps.between(last_ns, last_ns + longest_ms * MS)
    assert gaps.between(last_ns, last_ns + longest_ms * MS + 1)


def test_a_filled_gap_is_remembered_until_it_is_over():
    gaps = Gaps(100.0)
    gaps.remember(100, 200)
    assert gaps.overlap(0, 101)
    assert gaps.overlap(199, 300)
    assert not gaps.overlap(200, 300)
    gaps.drop_before(201)
    assert not gaps.overlap(0, 300)


def test_what_is_carried_on_turns_evenly_and_keeps_the_body_s_own_velocity():
    rng = np.random.default_rng(2)
    R, bias, rate = se3.so3_exp(rng.normal(size=3)), rng.normal(0, 0.05, 6), np.array([0.1, -0.2, 0.6])
    state = np.concatenate([R.reshape(-1), np.zeros(3), R @ [1.5, 0.2, 0.0]])
    gyro = rate + bias[:3]
    samples = carried_on(START_NS, START_NS + 1000 * MS, (gyro, gyro), state, bias, G)
    assert samples.stamps_ns[-1] == START_NS + 1000 * MS
    assert (np.diff(samples.stamps_ns) == 10 * MS).all()
    first = carried_on(START_NS, START_NS + MS, (gyro, gyro), state, bias, G)
    states = np.empty((len(samples) + 1, 15))
    states[0] = state
    kernels.integrate(
        np.concatenate([[START_NS], samples.stamps_ns]),
        np.vstack([gyro, samples.gyro_radps]),
        np.vstack([first.accel_mps2, samples.accel_mps2]),
        bias,
        G,
        states,
    )
    R_end = states[-1, :9].reshape(3, 3)
    np.testing.assert_allclose(R_end, R @ se3.so3_exp(rate), atol=1e-6)
    np.testing.assert_allclose(R_end.T @ states[-1, 12:], [1.5, 0.2, 0.0], atol=0.01)


def errors_with_a_gap(from_s: float, to_s: float, drive: Drive, seconds: float):
    """Errors of each predicted motion by scan, its sigma (m), and the node, when samples of that time never come."""
    node = make_node(200.0)
    original = node.add_imu

    def harmed(samples: ImuSamples):
        at_s = (samples.stamps_ns - START_NS) * 1e-9
        kept = (at_s < from_s) | (at_s >= to_s)
        return original(ImuSamples(samples.stamps_ns[kept], samples.gyro_radps[kept], samples.accel_mps2[kept]))

    node.add_imu = harmed  # type: ignore[method-assign]
    T_imu_lidar = se3.inv(node.robot.T_lidar_imu)
    errors, sigmas = [], []
    for _, start_ns, motion, _ in play(node, drive, seconds):
        t = (start_ns - START_NS) * 1e-9
        true = se3.inv(drive.T_odom_imu(t - 0.1) @ T_imu_lidar) @ drive.T_odom_imu(t) @ T_imu_lidar
        errors.append(np.linalg.norm((se3.inv(true) @ motion.T_prev_lidar)[:3, 3]))
        sigmas.append(np.sqrt(motion.covariance[3, 3]))
    return np.array(errors), np.array(sigmas), node


def test_a_second_without_samples_is_survived_and_its_doubt_is_said():
    errors, sigmas, node = errors_with_a_gap(8.0, 9.0, Drive(still_s=2.0), 12.0)
    inside, before, after = slice(81, 90), slice(60, 80), slice(100, None)
    assert errors[inside].max() < 0.05  # the curve goes on; what wobbles meanwhile is not foreseen
    assert np.median(errors[after]) < 2 * np.median(errors[before]) + 0.001
    assert (errors[inside] < 3 * np.sqrt(3) * sigmas[inside]).all()
    assert sigmas[inside].min() > 5 * np.median(sigmas[before])
    assert node.resets == 0
    assert node.jumps["odom_max_m"] < 0.02


def test_an_imu_that_never_speaks_leaves_a_node_that_follows_the_answers():
    errors, _, node = errors_with_a_gap(-np.inf, np.inf, Drive(still_s=2.0, wobble_rad=0.02), 10.0)
    assert np.median(errors[60:]) < 0.02
    motion = node.motion_over(START_NS + 98 * SCAN_NS, START_NS + 99 * SCAN_NS)
    assert motion.gravity_sigma_rad > 0.4  # nobody has said where down is


def test_an_imu_that_comes_late_levels_the_robot_then():
    errors, _, node = errors_with_a_gap(-np.inf, 4.0, Drive(still_s=2.0), 14.0)
    assert np.median(errors[100:]) < 0.003
    motion = node.motion_over(START_NS + 137 * SCAN_NS, START_NS + 138 * SCAN_NS)
    assert motion.gravity_sigma_rad < 0.4
