"""What the Imu node knows at a scan, and how good its IMU is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam import se3

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class NavigationState:
    """The IMU at `stamp_ns`: T_odom_imu (4, 4), velocity (3,) in `odom`, bias (6,) gyro first, and what is in doubt.

    velocity_covariance: (3, 3) in `odom`.
    """

    stamp_ns: int
    T_odom_imu: Array
    velocity_mps: Array
    bias: Array
    velocity_covariance: Array
    tilt_sigma_rad: float

    @property
    def velocity_sigma_mps(self) -> float:
        """Of one axis, in the mean."""
        return float(np.sqrt(np.trace(self.velocity_covariance) / 3))

    @property
    def row(self) -> Array:
        """(15,), see _kernels.py."""
        return np.concatenate([self.T_odom_imu[:3, :3].reshape(-1), self.T_odom_imu[:3, 3], self.velocity_mps])


def pose_and_velocity(row: Array) -> tuple[Array, Array]:
    """T_odom_imu (4, 4) and the velocity (3,) in `odom`, m/s, of a row (15,)."""
    return se3.compose(row[:9].reshape(3, 3), row[9:12]), row[12:].copy()


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """White noise densities and random walks of the IMU."""

    gyro_radps_rthz: float
    accel_mps2_rthz: float
    gyro_walk: float
    accel_walk: float
