"""The motion of the LiDAR as its own odometry saw it, without the IMU."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.check.rotations import increments

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LidarMotion:
    """Poses of the LiDAR in any fixed frame, here `odom`. stamps_ns: (K,) int64. T_odom_lidar: (K, 4, 4)."""

    stamps_ns: NDArray[np.int64]
    T_odom_lidar: Array

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def rates_radps(self) -> Array:
        """(K - 1,) mean rotation speed between neighbouring poses."""
        return np.linalg.norm(increments(self.T_odom_lidar[:, :3, :3]), axis=1) / (np.diff(self.stamps_ns) * 1e-9)


def at_mid_scan(start_ns: NDArray[np.int64], end_ns: NDArray[np.int64], T_odom_lidar: Array) -> LidarMotion:
    """Poses (K, 4, 4) at scan starts, found without an IMU -> poses at the middles of scans 2 to K.

    Without an IMU a scan is deskewed with the motion since the scan before. Where the robot turns faster and faster
    that is too little, and the pose at the scan's start comes out wrong by half of what is missing. In the middle of
    the scan, where registration really holds it, the error cancels: half the scan with the very motion assumed.
    """
    half = 0.5 * (end_ns - start_ns)[1:] / np.diff(start_ns)
    T = [a @ se3.exp((1.0 + share) * se3.log(se3.inv(a) @ b)) for a, b, share in _pairs(T_odom_lidar, half)]
    return LidarMotion((start_ns + (end_ns - start_ns) // 2)[1:], np.array(T).reshape(-1, 4, 4))


def _pairs(T: Array, share: Array) -> list[tuple[Array, Array, float]]:
    return list(zip(T[:-1], T[1:], share.tolist(), strict=True))
