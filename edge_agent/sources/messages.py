"""sensor_msgs/Imu, nav_msgs/Odometry and NavSatFix -> the records of `splitslam.scan`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from splitslam.errors import DataError
from splitslam.scan import GnssFix, ImuSamples, WheelSamples

_FASTEST = 100.0  # m/s and rad/s: what is beyond is no measurement


def stamp_ns(header: Any) -> int:
    """std_msgs/Header -> ns since the epoch."""
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def imu_samples(message: Any, time_offset_ns: int) -> ImuSamples:
    """One Imu message -> one sample; its orientation is not used. DataError `imu_nan`."""
    w, a = message.angular_velocity, message.linear_acceleration
    values = (w.x, w.y, w.z, a.x, a.y, a.z)
    if not all(map(math.isfinite, values)):
        raise DataError("imu_nan")
    numbers = np.array(values, dtype=np.float64)
    stamps_ns = np.array([stamp_ns(message.header) + time_offset_ns], dtype=np.int64)
    return ImuSamples(stamps_ns, numbers[None, :3], numbers[None, 3:])


def wheel_samples(message: Any, time_offset_ns: int) -> WheelSamples:
    """One Odometry message -> one reading, its twist alone: the pose is the sum of all slips. DataError `wheel_nan`
    or `wheel_range`."""
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    values = (linear.x, linear.y, angular.z)
    if not all(map(math.isfinite, values)):
        raise DataError("wheel_nan")
    if max(map(abs, values)) > _FASTEST:
        raise DataError("wheel_range")
    numbers = np.array(values, dtype=np.float64)
    stamps_ns = np.array([stamp_ns(message.header) + time_offset_ns], dtype=np.int64)
    return WheelSamples(stamps_ns, numbers[None, :2], numbers[2:])


def gnss_fix(message: Any) -> GnssFix:
    """One NavSatFix -> GnssFix. DataError `gnss_no_fix` or `gnss_nan`."""
    if message.status.status < 0:
        raise DataError("gnss_no_fix")
    values = (message.latitude, message.longitude, message.altitude)
    if not all(map(math.isfinite, values)) or abs(values[0]) > 90 or abs(values[1]) > 360:
        raise DataError("gnss_nan")
    covariance = None
    if message.position_covariance_type != 0:  # COVARIANCE_TYPE_UNKNOWN
        matrix = np.array(message.position_covariance, dtype=np.float64).reshape(3, 3)
        if np.isfinite(matrix).all() and (np.diag(matrix) > 0).all():
            covariance = matrix
    return GnssFix(stamp_ns(message.header), *values, covariance, int(message.status.status))
