"""Wheel odometry in the Imu node's graph: a velocity at each scan, and the scale of the wheels as a variable.

Key S: by how much the wheels read too little, v = (1 + s) v_read. Where the LiDAR observes the motion it calibrates the
wheels; where it does not, the calibrated wheels hold the velocity. Without S a tyre worn by 1 % would pull on every
pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X
from numpy.typing import NDArray

from splitslam import se3

Array = NDArray[np.float64]
S_KEY = gtsam.symbol("s", 0)
_ROBUST_SIGMAS = 2.0
_RESET_SIGMA = 1e-3  # what the scale may change by while one graph lasts


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
    """Adds wheel velocities to one LocalGraph; geometry (3, 4): R_wheel_imu and the wheel frame's origin in `imu`."""

    def __init__(self, geometry: Array, scale_sigma: float) -> None:
        self.geometry = geometry
        self.scale, self.scale_sigma = 0.0, scale_sigma
        self.count = 0
        self._alive: list[Callable[..., Array]] = []  # gtsam keeps no reference to a Python error function

    def begin(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, reset: bool) -> None:
        """A new graph: the scale starts from what is known of it."""
        self._alive.clear()
        sigma = float(np.hypot(self.scale_sigma, _RESET_SIGMA)) if reset else self.scale_sigma
        graph.add(gtsam.PriorFactorVector(S_KEY, np.array([self.scale]), gtsam.noiseModel.Isotropic.Sigma(1, sigma)))
        values.insert(S_KEY, np.array([self.scale]))

    def add(self, graph: gtsam.NonlinearFactorGraph, k: int, wheel: WheelVelocity) -> None:
        """The velocity at scan k."""
        error = _error(wheel, self.geometry)
        kernel = gtsam.noiseModel.mEstimator.Huber.Create(_ROBUST_SIGMAS)
        noise = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Diagonal.Sigmas(wheel.sigmas_mps))
        self._alive.append(error)
        graph.add(gtsam.CustomFactor(noise, [X(k), V(k), B(k), S_KEY], error))
        self.count += 1

    def read(self, isam: gtsam.ISAM2) -> None:
        """Takes the scale out of the optimised graph."""
        self.scale = float(isam.calculateEstimateVector(S_KEY)[0])
        self.scale_sigma = float(np.sqrt(isam.marginalCovariance(S_KEY)[0, 0]))


def _error(wheel: WheelVelocity, geometry: Array) -> Callable[..., Array]:
    """r = R_wheel_imu (R^T v + (gyro - b) x t) - (1 + s) v_read, its rows `axes`, and its derivatives."""
    lever = geometry[:, 3]
    read = np.where(wheel.measured, wheel.velocity_mps, 0.0)

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose, velocity, bias, scale = this.keys()
        R = values.atPose3(pose).rotation().matrix()
        body = R.T @ values.atVector(velocity)
        rate = wheel.rate_radps - values.atConstantBias(bias).gyroscope()
        R_wheel_imu = geometry[wheel.axes, :3]
        if jacobians is not None:
            rows = len(wheel.axes)
            jacobians[0] = np.asfortranarray(np.hstack([R_wheel_imu @ se3.hat(body), np.zeros((rows, 3))]))
            jacobians[1] = np.asfortranarray(R_wheel_imu @ R.T)
            jacobians[2] = np.asfortranarray(np.hstack([np.zeros((rows, 3)), R_wheel_imu @ se3.hat(lever)]))
            jacobians[3] = np.asfortranarray(-read[:, None])
        s = float(values.atVector(scale)[0])
        return R_wheel_imu @ (body + np.cross(rate, lever)) - (1.0 + s) * read

    return error
