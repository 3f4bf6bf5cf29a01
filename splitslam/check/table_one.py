"""A recording as a row of the paper's Table I: scans, elevation change, trajectory length, largest rotation speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.check.coarse import thinned
from splitslam.check.motion import LidarMotion
from splitslam.scan import ImuSamples

_STEP_M = 0.05  # a standing robot's jitter is no path


@dataclass(frozen=True, slots=True)
class TableOne:
    """elevation_change_m: highest less lowest point of the trajectory. max_rotation_degps: by the gyro (at 200 Hz), or
    by LiDAR odometry without one."""

    scans: int
    elevation_change_m: float
    path_m: float
    max_rotation_degps: float


def table_one(scans: int, motion: LidarMotion, up_odom: NDArray[np.float64], imu: ImuSamples | None) -> TableOne:
    """motion: LiDAR odometry; up_odom: (3,) unit vector in its frame. imu: in rad/s, or None."""
    positions_m = motion.T_odom_lidar[:, :3, 3]
    height_m = positions_m @ up_odom
    if imu is None:
        fastest = float(motion.rates_radps().max(initial=0.0))
    else:
        fastest = float(np.linalg.norm(thinned(imu).gyro_radps, axis=1).max(initial=0.0))
    return TableOne(scans, float(np.ptp(height_m)), _path_m(positions_m), float(np.degrees(fastest)))


def _path_m(positions_m: NDArray[np.float64]) -> float:
    """Sum of steps of at least 5 cm."""
    total_m, last = 0.0, positions_m[0]
    for position in positions_m[1:]:
        step_m = float(np.linalg.norm(position - last))
        if step_m >= _STEP_M:
            total_m, last = total_m + step_m, position
    return total_m
