"""What leaves the Imu node: T_odom_lidar at IMU rate, without a jump, and what of it is remembered."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import _kernels as kernels
from edge_agent.imu.history import PoseHistory
from edge_agent.imu.settings import ImuSettings
from edge_agent.types import OdomPoses

Array = NDArray[np.float64]


class ContinuousOutput:
    """Moves as the IMU says and closes in on the corrected state a little with each sample."""

    def __init__(self, settings: ImuSettings, T_imu_lidar: Array) -> None:
        limits = settings.blend_time_s, settings.blend_max_radps, settings.blend_max_mps
        self._limits = np.array([*limits, settings.blend_step_rad, settings.blend_step_m])
        self._T_imu_lidar = T_imu_lidar
        self._history = PoseHistory(int(settings.history_s * 1e9))
        self._worst = np.zeros(2)
        self._T_odom_imu = np.eye(4)[:3].reshape(-1)  # as it was given out last

    def begin(self, stamp_ns: int, T_odom_imu: Array) -> None:
        """The first pose (4, 4)."""
        self._T_odom_imu = T_odom_imu[:3].flatten()
        self._history.append(np.array([stamp_ns]), (T_odom_imu @ self._T_imu_lidar)[None, :3].reshape(1, 12))

    def follow(self, stamps_ns: NDArray[np.int64], states: Array) -> OdomPoses:
        """The poses at all stamps (M,) but the first, which has been given out; states: (M, 15), see _kernels.py."""
        poses, positions, quats = np.empty((len(states), 12)), np.empty((len(states), 3)), np.empty((len(states), 4))
        kernels.lead(stamps_ns, states, self._limits, self._T_imu_lidar, self._T_odom_imu, self._worst, poses)
        kernels.split(poses, positions, quats)
        self._history.append(stamps_ns[1:], poses[1:])
        return OdomPoses(stamps_ns[1:], positions[1:], quats[1:], states[1:, 12:].copy())

    def at(self, stamp_ns: int) -> Array:
        """The pose (4, 4) that was given out for `stamp_ns`, interpolated between IMU samples."""
        return self._history.at(stamp_ns)

    @property
    def jumps(self) -> dict[str, float]:
        """Largest difference between one increment of T_odom_lidar and the IMU's own propagation over it."""
        return {"odom_max_m": float(self._worst[0]), "odom_max_deg": float(np.degrees(self._worst[1]))}


def no_poses() -> OdomPoses:
    """Nothing to give out yet."""
    return OdomPoses(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 4)), np.empty((0, 3)))
