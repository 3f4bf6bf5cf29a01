"""Sensors that are away for minutes or days cost no memory, and do not send the robot off."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.imu.node import ImuNode
from splitslam.features import Motion
from splitslam.scan import ImuSamples
from tests.imu.made import SCAN_NS, START_NS, Drive, G, make_node, play

RATE_HZ, STEP_NS = 200, 5_000_000
CHUNK = 20
ERROR = np.array([0.001, -0.0005, 0.0008]), np.array([0.02, -0.015, 0.01])  # of gyro and accelerometer, drifted since
WALKED_S, WALK = 5.0, Drive()


def walked() -> tuple[ImuNode, np.ndarray]:
    """A node that has seen a walk, and T_odom_lidar at its end."""
    node = make_node(RATE_HZ)
    for _ in play(node, WALK, WALKED_S):
        pass
    return node, node.T_odom_lidar_at(node.imu.last_ns)


def standing(node: ImuNode, first_ns: int, seconds: float, R_odom_imu: np.ndarray):
    """Samples of a robot that stands; yields the poses of each chunk."""
    accel = R_odom_imu.T @ [0.0, 0.0, G] + WALK.accel_bias + ERROR[1]
    for first in range(0, round(seconds * RATE_HZ), CHUNK):
        stamps_ns = first_ns + (first + np.arange(CHUNK)) * STEP_NS
        gyro = np.tile(WALK.gyro_bias + ERROR[0], (CHUNK, 1))
        yield node.add_imu(ImuSamples(stamps_ns, gyro, np.tile(accel, (CHUNK, 1))))


def is_unseen(motion: Motion) -> bool:
    """Nothing is claimed of the way since the scan before."""
    sigma_m = np.sqrt(np.diag(motion.covariance)[3:])
    return not motion.velocity_known and bool((sigma_m > 10.0).all()) and not motion.T_prev_lidar[:3, 3].any()


def test_minutes_without_a_scan_fill_no_memory_and_leave_the_robot_about_where_it_was() -> None:
    node, before = walked()
    R_odom_imu = before[:3, :3] @ node.T_lidar_imu[:3, :3]
    most, newest, largest_m = 0, before[:3, 3], 0.0
    for poses in standing(node, node.imu.last_ns + STEP_NS, 600.0, R_odom_imu):
        most = max(most, len(node.imu))
        steps_m = np.linalg.norm(np.diff(np.vstack([newest, poses.positions_m]), axis=0), axis=1)
        newest, largest_m = poses.positions_m[-1], max(largest_m, float(steps_m.max()))
    assert most < 30 * RATE_HZ
    assert largest_m < 0.25, "50 m/s, and no step"
    assert np.linalg.norm(newest - before[:3, 3]) < 1000.0, "what biases do in a minute, not the 300 km of ten"
    end_ns = node.imu.last_ns
    assert is_unseen(node.motion_over(end_ns - SCAN_NS - STEP_NS, end_ns - STEP_NS))
    again = node.motion_over(end_ns - STEP_NS, end_ns)
    assert not again.velocity_known
    assert np.linalg.norm(again.T_prev_lidar[:3, 3]) < 1.0


@pytest.mark.parametrize("lidar_first", [False, True])
@pytest.mark.parametrize("hours", [0.02, 4.0, 60.0])
def test_a_night_without_any_sensor_passes_at_once_and_the_robot_stands_where_it_was(
    hours: float, lidar_first: bool
) -> None:
    node, before = walked()
    back_ns = node.imu.last_ns + int(hours * 3600e9)
    if lidar_first:
        assert is_unseen(node.motion_over(back_ns, back_ns + SCAN_NS))
        back_ns += 2 * SCAN_NS
    R_odom_imu = before[:3, :3] @ node.T_lidar_imu[:3, :3]
    poses = list(standing(node, back_ns, 0.2, R_odom_imu))
    assert sum(len(some.stamps_ns) for some in poses) < 1000
    assert np.linalg.norm(poses[-1].positions_m[-1] - before[:3, 3]) < 1.0
    assert len(node.imu) < 1000
    motion = node.motion_over(back_ns - 1000, back_ns + SCAN_NS)
    assert is_unseen(motion) is not lidar_first, "told once"
    assert not motion.velocity_known


def test_a_lidar_that_never_comes_fills_no_memory() -> None:
    node = make_node(RATE_HZ)
    for _ in standing(node, START_NS, 300.0, np.eye(3)):
        pass
    assert len(node.imu) < 30 * RATE_HZ
    motion = node.motion_over(node.imu.last_ns - SCAN_NS, node.imu.last_ns)
    assert motion.gravity_lidar @ node.T_lidar_imu[:3, :3] @ [0.0, 0.0, -1.0] > np.cos(0.02)
