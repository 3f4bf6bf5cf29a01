"""A made motion of a LiDAR with an IMU on it: exact poses, exact samples, then noise and whatever is wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from splitslam import se3
from splitslam.check.motion import LidarMotion
from splitslam.robot import Robot, robot_from_yaml
from splitslam.scan import ImuSamples

G = 9.80665
START_NS = 1_700_000_000_000_000_000
SCAN_S = 0.1
T_LIDAR_IMU = se3.compose(
    Rotation.from_euler("xyz", [4.0, -7.0, 100.0], degrees=True).as_matrix(), np.array([0.1, -0.05, 0.2])
)


@dataclass(frozen=True)
class Drive:
    """wobble_rad: how far it rolls and pitches; surge_m: how strongly speed changes; turn_rad: how far it turns."""

    wobble_rad: float = 0.06
    turn_rad: float = 0.8
    surge_m: float = 0.6
    speed_mps: float = 1.5

    def attitude(self, t: np.ndarray) -> np.ndarray:
        yaw = self.turn_rad * np.sin(0.9 * t) + 0.3 * self.turn_rad * np.sin(2.3 * t)
        pitch = self.wobble_rad * np.sin(2.9 * t + 0.4)
        roll = self.wobble_rad * np.sin(2.1 * t + 1.9)
        return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()

    def position(self, t: np.ndarray) -> np.ndarray:
        along = self.speed_mps * t + self.surge_m * np.sin(1.3 * t)
        return np.stack([along, 0.3 * self.surge_m * np.sin(0.7 * t), np.zeros_like(t)], axis=1)


WALK = Drive()
CAR = Drive(wobble_rad=0.0, turn_rad=0.4, surge_m=2.0, speed_mps=6.0)
SMOOTH_CAR = Drive(wobble_rad=0.0, turn_rad=0.4, surge_m=0.0, speed_mps=0.0)  # turns on the spot
STANDING = Drive(wobble_rad=0.0, turn_rad=0.0, surge_m=0.0, speed_mps=0.0)


def motion(drive: Drive, seconds: float, seed: int = 1, noise_rad: float = 3e-4, noise_m: float = 5e-3) -> LidarMotion:
    """Poses each 0.1 s with the noise of a LiDAR odometry."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / SCAN_S)) * SCAN_S
    T = np.tile(np.eye(4), (len(t), 1, 1))
    T[:, :3, :3] = drive.attitude(t) @ Rotation.from_rotvec(noise_rad * rng.normal(size=(len(t), 3))).as_matrix()
    T[:, :3, 3] = drive.position(t) + noise_m * rng.normal(size=(len(t), 3))
    return LidarMotion(START_NS + np.rint(t * 1e9).astype(np.int64), T)


def samples(
    drive: Drive, seconds: float, rate_hz: float = 200.0, delay_s: float = 0.0, seed: int = 2, noise: float = 1.0
) -> ImuSamples:
    """IMU samples from a second before the first pose to a second after the last; stamps tell delay_s too late."""
    rng = np.random.default_rng(seed)
    t = np.arange(-1.0, seconds + 1.0, 1.0 / rate_hz)
    h = 1e-4
    before, now, after = (drive.attitude(t + d) for d in (-h, 0.0, h))
    R = T_LIDAR_IMU[:3, :3]
    gyro = Rotation.from_matrix(before.transpose(0, 2, 1) @ after).as_rotvec() / (2 * h) @ R
    place = [drive.position(t + d) + A @ T_LIDAR_IMU[:3, 3] for d, A in ((-h, before), (0.0, now), (h, after))]
    force = (place[0] - 2 * place[1] + place[2]) / h**2 + np.array([0.0, 0.0, G])
    accel = np.einsum("nji,nj->ni", now, force) @ R
    gyro = gyro + np.array([0.003, -0.002, 0.004]) + noise * 2e-3 * rng.normal(size=gyro.shape)
    accel = accel + np.array([0.05, -0.03, 0.04]) + noise * 0.05 * rng.normal(size=accel.shape)
    return ImuSamples(START_NS + np.rint((t + delay_s) * 1e9).astype(np.int64), gyro, accel)


def robot(T_lidar_imu: np.ndarray = T_LIDAR_IMU, rate_hz: float = 200.0) -> Robot:
    rows = [[float(v) for v in row] for row in T_lidar_imu]
    return robot_from_yaml(f"{{imu: {{topic: /imu, rate_hz: {rate_hz}}}, T_lidar_imu: {rows}}}")


def turned(axis: int, angle_deg: float) -> np.ndarray:
    """T_lidar_imu with its rotation wrong about one axis of the LiDAR."""
    vector = np.zeros(3)
    vector[axis] = np.radians(angle_deg)
    return se3.compose(se3.so3_exp(vector) @ T_LIDAR_IMU[:3, :3], T_LIDAR_IMU[:3, 3])
