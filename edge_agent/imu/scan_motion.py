"""The motion that a scan was taken in, out of the IMU integrated from the newest optimised state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import _kernels as kernels
from edge_agent.imu.buffer import ImuWindow
from edge_agent.imu.settings import ImuSettings
from edge_agent.imu.state import ImuNoise
from splitslam import se3
from splitslam.features import Knots, Motion

Array = NDArray[np.float64]
_EYE = np.eye(3)
_LEAST = 1e-8  # variance of what is integrated exactly, rad^2 and m^2


class ScanMotion:
    """Of one robot, whose extrinsics are T_lidar_imu and T_imu_lidar (4, 4)."""

    def __init__(self, settings: ImuSettings, T_lidar_imu: Array, T_imu_lidar: Array) -> None:
        self._settings, self._T_imu_lidar = settings, T_imu_lidar
        self._R_lidar_imu, self._lever_m = T_lidar_imu[:3, :3], T_imu_lidar[:3, 3]

    def of(
        self,
        window: ImuWindow,
        states: Array,
        rows: tuple[int, int],
        bias: Array,
        velocity_covariance: Array,
        noise: ImuNoise,
        known: tuple[float, bool],
    ) -> Motion:
        """The LiDAR's motion from state rows[0] to rows[1], the scan's reference time, and in the scan from there on.

        states: (M, 15) at the window's stamps. velocity_covariance: (3, 3) in `odom` at the reference time. known: the
        sigma of where down is, rad, and whether the velocity is known.
        """
        previous, here = rows
        T_prev_lidar, poses = np.eye(4), np.empty((len(states) - here, 12))
        kernels.scan_motion(states, previous, here, self._T_imu_lidar, T_prev_lidar, poses)
        R = poses[0].reshape(3, 4)[:, :3]
        lever_mps = se3.hat(window.gyro_radps[here] - bias[:3]) @ self._lever_m
        rotation, translation = np.empty((len(poses), 3)), np.empty((len(poses), 3))
        kernels.knots(poses, rotation, translation)
        stamps_ns = window.stamps_ns
        interval_s = float(stamps_ns[here] - stamps_ns[previous]) * 1e-9
        return Motion(
            T_prev_lidar=T_prev_lidar,
            covariance=self._covariance(interval_s, R.T @ velocity_covariance @ R, noise),
            velocity_lidar_mps=R.T @ states[here, 12:] + self._R_lidar_imu @ lever_mps,
            knots=Knots(stamps_ns[here:] - stamps_ns[here], rotation, translation),
            gravity_lidar=-R[2],
            gravity_sigma_rad=known[0],
            velocity_known=known[1],
        )

    def _covariance(self, interval_s: float, velocity_lidar: Array, noise: ImuNoise) -> Array:
        """(6, 6) of the motion over an interval; velocity_lidar: (3, 3) covariance of the velocity, frame `lidar`."""
        s = self._settings
        rotation = noise.gyro_radps_rthz**2 * interval_s + (0.1 * s.prior_bias_gyro_radps * interval_s) ** 2
        velocity = velocity_lidar + _EYE * (noise.accel_mps2_rthz**2 * interval_s)
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = _EYE * (_LEAST + rotation)
        covariance[3:, 3:] = velocity * interval_s**2 + _EYE * _LEAST
        return covariance
