"""The paper's Imu node."""

from __future__ import annotations

from edge_agent.imu.constant_velocity import ConstantVelocityNode
from edge_agent.imu.node import ImuNode
from edge_agent.imu.settings import ImuSettings
from splitslam.robot import Robot


def make_imu_node(robot: Robot, settings: ImuSettings, enabled: bool = True) -> ImuNode | ConstantVelocityNode:
    """The node for this robot: without an IMU, or with it switched off, motion goes on as it was."""
    if robot.imu is None or not enabled:
        return ConstantVelocityNode(robot, settings)
    return ImuNode(robot, settings)
