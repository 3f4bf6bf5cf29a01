"""A made drive for the Imu node: exact poses, exact IMU, a perfect map service with a delay of two scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge_agent.imu.node import ImuNode
from edge_agent.imu.settings import ImuSettings
from edge_agent.types import OdometryReply
from splitslam import se3
from splitslam.robot import Robot, robot_from_yaml
from splitslam.scan import ImuSamples

G = 9.80665
START_NS = 1_700_000_000_000_000_000
SCAN_NS = 100_000_000


def robot(rate_hz: float = 200.0) -> Robot:
    T = se3.compose(se3.so3_exp(np.array([0.05, -0.1, 1.5])), np.array([0.1, -0.05, 0.2]))
    rows = [[float(v) for v in row] for row in T]
    return robot_from_yaml(f"{{imu: {{topic: /imu, rate_hz: {rate_hz}}}, T_lidar_imu: {rows}}}")


@dataclass(frozen=True)
class Drive:
    """A curve with wobbling attitude; still for `still_s` when speed_mps starts at zero."""

    speed_mps: float = 1.5
    still_s: float = 0.0
    wobble_rad: float = 0.1
    gyro_bias: tuple[float, float, float] = (0.002, -0.001, 0.003)
    accel_bias: tuple[float, float, float] = (0.03, -0.02, 0.02)

    def T_odom_imu(self, t: float) -> np.ndarray:
        u = max(t - self.still_s, 0.0) if self.still_s else t  # in motion already before it begins: no step at 0
        distance = self.speed_mps * (u if self.still_s == 0 else u - np.arctan(u))
        heading = 0.05 * distance
        w = self.wobble_rad * (1 - np.exp(-u)) if self.still_s else self.wobble_rad
        R = se3.so3_exp(np.array([0, 0, heading])) @ se3.so3_exp(np.array([w * np.sin(2 * u), w * np.sin(1.3 * u), 0]))
        position = np.array([np.sin(heading), 1 - np.cos(heading), 0]) / 0.05
        position[2] = 0.1 * (1 - np.cos(u)) if self.still_s == 0 else 0.0
        return se3.compose(R, position)

    def imu(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        h = 1e-4
        a, b, c = (self.T_odom_imu(t + d) for d in (-h, 0.0, h))
        gyro = se3.so3_log(a[:3, :3].T @ c[:3, :3]) / (2 * h)
        acceleration = (a[:3, 3] - 2 * b[:3, 3] + c[:3, 3]) / h**2
        accel = b[:3, :3].T @ (acceleration + np.array([0, 0, G]))
        return gyro + self.gyro_bias, accel + self.accel_bias


def play(node: ImuNode, drive: Drive, seconds: float, rate_hz: float = 200.0, *, answers: bool = True, delay: int = 2):
    """Feeds samples, scans and answers in lockstep; yields (scan index, stamp_ns, motion, emitted poses)."""
    description = node.robot
    stamps = START_NS + np.arange(int(seconds * rate_hz)) * int(1e9 / rate_hz)
    values = [drive.imu((s - START_NS) * 1e-9) for s in stamps]
    T0 = drive.T_odom_imu(0.0) @ se3.inv(description.T_lidar_imu)
    done = 0
    replies: list[OdometryReply] = []
    for k in range(int(seconds * 10) - 2):
        start = START_NS + k * SCAN_NS
        end = start + SCAN_NS
        upto = int(np.searchsorted(stamps, end)) + 1
        gyro, accel = np.array([v[0] for v in values[done:upto]]), np.array([v[1] for v in values[done:upto]])
        poses = node.add_imu(ImuSamples(stamps[done:upto], gyro, accel)) if upto > done else None
        done = upto
        if answers and k >= delay:
            node.on_odometry(replies[k - delay])
        motion = node.motion_over(start, end)
        if k == 0:
            level = se3.compose(se3.level_rotation(-motion.gravity_lidar), np.zeros(3))
        T_map_lidar = level @ se3.inv(T0) @ drive.T_odom_imu(k * 0.1) @ se3.inv(description.T_lidar_imu)
        replies.append(OdometryReply(k + 1, start, T_map_lidar, np.eye(4), np.eye(6) * 1e-4, 2, np.zeros((0, 6))))
        yield k, start, motion, poses


def make_node(rate_hz: float = 200.0, **settings) -> ImuNode:
    return ImuNode(robot(rate_hz), ImuSettings(**settings))
