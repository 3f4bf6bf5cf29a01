"""Wheel odometry in the Imu node's filter: a velocity at each scan, and the scale of the wheels as a part of the state.

The scale s says by how much the wheels read too little, v = (1 + s) v_read. Where the LiDAR observes the motion it
calibrates the wheels; where it does not, the calibrated wheels hold the velocity. Without it a tyre worn by 1 % would
pull on every pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam import se3

Array = NDArray[np.float64]
WANDER_RTS = 3e-4  # of the scale, a square root of a second


@dataclass(frozen=True, slots=True, eq=False)
class WheelVelocity:
    """The velocity of the wheel frame's origin at a scan, in `wheel`, as read (not scaled).

    axes: which of x, y, z; velocity_mps, sigmas_mps, measured: one entry for each of them. measured is False for a
    velocity that is only known to be about zero. rate_radps: (3,) gyro of `imu` then, its bias in it.
    """

    axes: NDArray[np.int64]
    velocity_mps: Array
    sigmas_mps: Array
    measured: NDArray[np.bool_]
    rate_radps: Array


class WheelFactors:
    """What one robot's wheels say; geometry (3, 4): R_wheel_imu and the wheel frame's origin in `imu`.

    scale, scale_sigma: as the filter knows them. count: measurements so far.
    """

    def __init__(self, geometry: Array, scale_sigma: float) -> None:
        self.geometry = geometry
        self.scale, self.scale_sigma = 0.0, scale_sigma
        self.count = 0

    def error(
        self, wheel: WheelVelocity, R_odom_imu: Array, velocity_mps: Array, gyro_bias: Array, scale: float
    ) -> tuple[Array, Array]:
        """r = R_wheel_imu (R^T v + (gyro - b) x t) - (1 + s) v_read, its rows `axes` (K,), and its derivatives (K, 10).

        These are by the error of the rotation in `odom` (from the left), by v, b and s.
        """
        lever, R_wheel_imu = self.geometry[:, 3], self.geometry[wheel.axes, :3]
        read = np.where(wheel.measured, wheel.velocity_mps, 0.0)
        by_velocity = R_wheel_imu @ R_odom_imu.T
        r = by_velocity @ velocity_mps + R_wheel_imu @ np.cross(wheel.rate_radps - gyro_bias, lever)
        by_rotation, by_bias = by_velocity @ se3.hat(velocity_mps), R_wheel_imu @ se3.hat(lever)
        return r - (1.0 + scale) * read, np.hstack([by_rotation, by_velocity, by_bias, -read[:, None]])
