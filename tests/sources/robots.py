"""Robot files for the tests."""

from __future__ import annotations

from splitslam.robot import Robot, robot_from_yaml

RIGID = "T_lidar_imu: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"


def robot(lidar: str = "rings: 3", rest: str = RIGID) -> Robot:
    """A robot whose lidar section is `{lidar}`."""
    return robot_from_yaml(f"lidar: {{{lidar}}}\n{rest}\n")
