"""Where down is by the accelerometer alone: before the first answer, or when the first samples come late."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu.buffer import ImuWindow
from splitslam import se3

Array = NDArray[np.float64]
UNKNOWN_TILT_RAD, MOVING_TILT_RAD = 0.5, 0.1
_STILL_GYRO_RADPS = 0.03
_STILL_SAMPLES = 8  # in the first scan: an IMU of 80 Hz and up can tell


def level(window: ImuWindow, R_lidar_imu: Array, gravity_mps2: float) -> tuple[Array, float]:
    """R_odom_lidar (3, 3) without heading over the first scan, and the sigma of its tilt, rad."""
    accel, gyro, g = window.accel_mps2.mean(axis=0), window.gyro_radps.mean(axis=0), gravity_mps2
    spread = float(np.linalg.norm(window.accel_mps2.std(axis=0)))
    still = len(window.stamps_ns) >= _STILL_SAMPLES and np.linalg.norm(gyro) < _STILL_GYRO_RADPS and spread < 0.05 * g
    excess = abs(float(np.linalg.norm(accel)) - g) / g
    return se3.level_rotation(R_lidar_imu @ accel), max(0.01, excess) if still else MOVING_TILT_RAD


def level_at(T_odom_lidar: Array, window: ImuWindow, R_lidar_imu: Array) -> Array:
    """The pose (4, 4) where T_odom_lidar is, with its heading, level by what the window says."""
    T = T_odom_lidar.copy()
    heading = se3.so3_exp(np.array([0.0, 0.0, np.arctan2(T[1, 0], T[0, 0])]))
    T[:3, :3] = heading @ se3.level_rotation(R_lidar_imu @ window.accel_mps2.mean(axis=0))
    return T
