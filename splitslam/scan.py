"""Sensor data as it enters the system. Frames, units and times: docs/conventions.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One LiDAR message, valid points only (finite, inside the range gate), sensor order kept.

    stamp_ns: reference time = first firing of the message, before any range gate.
    end_ns: time of the last firing.
    points_lidar: (N, 3) float32, m, frame `lidar` at each point's own time (skewed).
    t_offset_ns: (N,) int32, time of each point after `stamp_ns`.
    ring: (N,) uint8. intensity: (N,) uint8.
    read_points: points in the message before the range gate (for the paper's Case 1 bytes use `len`).
    native_bytes: size of the sensor's own packets; 0 when the recording has none.
    """

    stamp_ns: int
    end_ns: int
    points_lidar: NDArray[np.float32]
    t_offset_ns: NDArray[np.int32]
    ring: NDArray[np.uint8]
    intensity: NDArray[np.uint8]
    read_points: int = 0
    native_bytes: int = 0

    def __len__(self) -> int:
        return len(self.points_lidar)


@dataclass(frozen=True, slots=True, eq=False)
class ImuSamples:
    """A run of IMU samples, strictly increasing in time.

    stamps_ns: (M,) int64. gyro_radps: (M, 3) float64, frame `imu`.
    accel_mps2: (M, 3) float64, specific force, frame `imu` (at rest: +g up).
    """

    stamps_ns: NDArray[np.int64]
    gyro_radps: NDArray[np.float64]
    accel_mps2: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @staticmethod
    def joined(runs: Sequence[ImuSamples]) -> ImuSamples:
        """Runs that follow each other as one; as they come, when they do not."""
        if len(runs) == 1:
            return runs[0]
        return ImuSamples(
            np.concatenate([run.stamps_ns for run in runs]),
            np.concatenate([run.gyro_radps for run in runs]),
            np.concatenate([run.accel_mps2 for run in runs]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class WheelSamples:
    """A run of wheel odometry readings, strictly increasing in time; frame `wheel` is T_body_wheel of the robot file.

    stamps_ns: (M,) int64. velocity_mps: (M, 2) float64, along x and y of `wheel`, of its origin.
    yaw_rate_radps: (M,) float64, about z of `wheel`.
    """

    stamps_ns: NDArray[np.int64]
    velocity_mps: NDArray[np.float64]
    yaw_rate_radps: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, slots=True, eq=False)
class GnssFix:
    """One WGS84 antenna position; covariance_enu_m2 is (3, 3) or None when the receiver does not say."""

    stamp_ns: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    covariance_enu_m2: NDArray[np.float64] | None
    status: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class ScanPacket:
    """A scan that the IMU covers to its end, and the GNSS fixes since the packet before.

    Every IMU sample up to the first one at or after `scan.end_ns` has been handed over before the packet.
    arrival_ns: when the scan came, on the source's steady clock; None: not known.
    """

    scan: Scan
    fixes: tuple[GnssFix, ...] = ()
    arrival_ns: int | None = None
