"""Wheel odometry beside the IMU: which readings to believe, and the velocity that they give.

A wheel slips; an integrated IMU drifts, but not within a tenth of a second. So each reading is held against the IMU's
own propagation from the last optimised state: turning wheels of a robot that stands, standing wheels of one that
slides, and everything between, contradict it by more than its growing doubt allows, and are left out.

Errors of the speed are alike for about a second (tyres, ground, a camber): the speed is fused as if one second of
readings were one. The constant part is the filter's `scale` (wheel_factor.py).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import _wheel_kernels as kernels
from edge_agent.imu.buffer import ImuWindow
from edge_agent.imu.settings import ImuSettings
from edge_agent.imu.wheel_factor import WheelFactors, WheelVelocity
from splitslam import se3
from splitslam.robot import Robot
from splitslam.scan import WheelSamples

Array = NDArray[np.float64]
_GATE = 9.0
_ALIKE_S = 1.0  # for how long errors of the speed are alike
_WANDER = 0.5  # share of the scale's standard deviation that comes and goes with the ground
_MOUNTING_RAD = 0.05  # a wheel frame that is turned by so much shows forward speed as sideways speed
_HALF_TRACK_M = 0.3  # wheels that disagree with the gyro about the yaw rate are as wrong about the speed, times this
_WINDOW_NS = 200_000_000  # readings this old still say something of the velocity now, given the IMU
_KEPT_NS = 1_000_000_000


class WheelAid:
    """One robot's wheels: the recent readings and what they say against the IMU."""

    def __init__(self, robot: Robot, settings: ImuSettings) -> None:
        assert robot.wheels is not None
        self.description, self.settings = robot.wheels, settings
        T_lidar_wheel = se3.inv(robot.T_body_lidar) @ robot.wheels.T_body_wheel
        T_imu_wheel = se3.inv(robot.T_lidar_imu) @ T_lidar_wheel
        self.geometry = np.column_stack([T_imu_wheel[:3, :3].T, T_imu_wheel[:3, 3]])
        self.factors = WheelFactors(self.geometry, float(robot.wheels.scale))
        self.slips = 0  # scans at which the wheels were not believed
        self._stamps = np.empty(0, np.int64)
        self._values = np.empty((0, 3))  # x, y, yaw rate

    def append(self, samples: WheelSamples) -> None:
        """Adds readings, all newer than the last."""
        self._stamps = np.concatenate([self._stamps, samples.stamps_ns])
        values = np.column_stack([samples.velocity_mps, samples.yaw_rate_radps])
        self._values = np.concatenate([self._values, values])

    def drop_before(self, stamp_ns: int) -> None:
        """Forgets readings older than a second before `stamp_ns`."""
        keep = int(np.searchsorted(self._stamps, stamp_ns - _KEPT_NS))
        self._stamps, self._values = self._stamps[keep:], self._values[keep:]

    @property
    def last_ns(self) -> int:
        """Stamp of the newest reading, or a time long ago."""
        return int(self._stamps[-1]) if len(self._stamps) else -(2**62)

    # --- between scans ----------------------------------------------------------------------------------------

    def aid(
        self, window: ImuWindow, states: Array, bias: Array, after_ns: int, noise: tuple[float, float], P: Array
    ) -> None:
        """Corrects states (M, 15), integrated over the window, by the readings in (after_ns, the window's end].

        noise: the accelerometer's density, m/s^2/sqrt(Hz), and the window's start's age since the last optimised
        state, s. P (3, 3): covariance of the velocity in `odom`, carried from the window's start to its end.
        """
        rates = window.gyro_radps - bias[:3]
        times_s = (window.stamps_ns - window.stamps_ns[0]) * 1e-9
        readings = self._readings(window, rates, after_ns, int(window.stamps_ns[-1]))
        s = self.settings
        doubt = np.array([noise[0] ** 2, s.drift_mps2**2, s.drift_s, noise[1]])
        kernels.aid(times_s, rates, states, readings, self.geometry, doubt, P)

    def _readings(self, window: ImuWindow, rates: Array, after_ns: int, until_ns: int) -> Array:
        """Rows for the kernels; times from the window's start on."""
        first, last = np.searchsorted(self._stamps, [after_ns, until_ns], side="right")
        stamps, values = self._stamps[first:last], self._values[first:last]
        rows = np.empty((len(stamps), 10))
        if not len(rows):
            return rows
        rows[:, 0] = (stamps - window.stamps_ns[0]) * 1e-9
        d, rate_hz = self.description, self._rate_hz()
        rows[:, 1:3] = (1.0 + self.factors.scale) * values[:, :2]
        rows[:, 3] = 0.0
        square = rows[:, 1] ** 2 + (rows[:, 2] ** 2 if d.holonomic else 0.0)
        turning = np.interp(rows[:, 0], (window.stamps_ns - window.stamps_ns[0]) * 1e-9, rates @ self.geometry[2, :3])
        twisted = (_HALF_TRACK_M * (values[:, 2] - turning)) ** 2
        alike = max(rate_hz * _ALIKE_S, 1.0)
        sideways = d.sideways_mps**2 + _MOUNTING_RAD**2 * square
        rows[:, 4] = d.speed_noise_mps**2 + d.scale**2 * square + twisted
        rows[:, 7] = d.speed_noise_mps**2 + twisted + alike * (self.factors.scale_sigma**2 + self._wander**2) * square
        rows[:, 5:7] = sideways[:, None]
        rows[:, 8:10] = alike * sideways[:, None]
        if d.holonomic:
            rows[:, 5], rows[:, 8] = rows[:, 4], rows[:, 7]
        else:
            rows[:, 2] = 0.0
        return rows

    @property
    def _wander(self) -> float:
        return _WANDER * self.description.scale

    def _rate_hz(self) -> float:
        if len(self._stamps) < 3:
            return float(self.description.rate_hz)
        return (len(self._stamps) - 1) / ((self._stamps[-1] - self._stamps[0]) * 1e-9)

    # --- at a scan --------------------------------------------------------------------------------------------

    def at_scan(
        self, window: ImuWindow, states: Array, bias: Array, velocity_sigma_mps: float, accel_noise: float
    ) -> WheelVelocity | None:
        """The velocity at the window's end for the filter; None without readings, or when they slip.

        states (M, 15): integrated over the window from the last optimised one, whose velocity is known that well.
        The readings of the last fifth of a second are carried to the end by the IMU and averaged, those left out
        that contradict it.
        """
        end_ns, rates = int(window.stamps_ns[-1]), window.gyro_radps - bias[:3]
        readings = self._readings(window, rates, max(end_ns - _WINDOW_NS, int(window.stamps_ns[0])), end_ns)
        if not len(readings):
            return None
        times_s = (window.stamps_ns - window.stamps_ns[0]) * 1e-9
        difference = np.empty((len(readings), 3))
        kernels.innovations(times_s, rates, states, readings, self.geometry, difference)
        drift = (accel_noise**2 + self.settings.drift_mps2**2 * times_s[-1]) * times_s[-1]
        doubt = velocity_sigma_mps**2 + drift
        believed = difference**2 <= _GATE * (doubt + readings[:, 4:7])
        axes = np.flatnonzero(2 * believed.sum(axis=0) > len(readings))
        if 0 not in axes:
            self.slips += 1
            return None
        here = np.empty(3)
        kernels.speed(states[-1], np.zeros(4), rates[-1], self.geometry, here)
        count = believed[:, axes].sum(axis=0)
        mean = here[axes] + np.where(believed, difference, 0.0)[:, axes].sum(axis=0) / count
        measured = np.array([True, self.description.holonomic, False])[axes]
        variance = readings[:, 4:7].mean(axis=0)[axes]
        alike = _ALIKE_S / max(times_s[-1], 0.02)  # scans whose errors are alike
        square = float(np.mean(readings[:, 1] ** 2))
        own = variance + (alike * self._wander**2 - self.description.scale**2) * square  # the scale is the filter's
        sigmas = np.sqrt(np.where(measured, own, alike * variance))
        unscaled = np.where(measured, mean / (1.0 + self.factors.scale), 0.0)
        return WheelVelocity(axes, unscaled, sigmas, measured, window.gyro_radps[-1].copy())
