"""Poses of the LiDAR at IMU rate -> what is said of the base, at the rate that is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from edge_agent.rate_grid import RateGrid
from edge_agent.types import OdomPoses
from splitslam import se3
from splitslam.robot import Robot

Array = NDArray[np.float64]
_GYRO_BIAS_RADPS = 1e-3  # of an angular velocity: what is left of the bias
_NO_GYRO_RADPS_RTHZ = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class BaseSample:
    """The base at one time, in the sensors' time.

    covariance: (6, 6) of the pose, right tangent at the base, rotation first, as the map service said last.
    twist: (6,), of the base in the base's frame, rotation first, mean since the sample before; doubt: its covariance.
    """

    stamp_ns: int
    T_odom_base: Array
    T_map_odom: Array
    covariance: Array
    twist: Array
    doubt: Array
    state: int


class ImuState(Protocol):
    """What the Imu node says of its newest poses; edge_agent.imu.node.ImuNode."""

    T_map_odom: Array
    covariance: Array

    @property
    def velocity_covariance(self) -> Array: ...


@dataclass(frozen=True, slots=True)
class Belief:
    """What belongs to poses besides, asked when they come. offset_ns: the run's time less the sensors' own."""

    imu: ImuState
    state: Callable[[], int]
    offset_ns: Callable[[], int]


class BaseSampler:
    """Thins poses to `rate_hz` (0: none left out) and moves them from the LiDAR to the base."""

    def __init__(self, robot: Robot, belief: Belief, rate_hz: float) -> None:
        self._belief = belief
        self._T_lidar_base = se3.inv(robot.T_body_lidar)
        self._to_base = se3.adjoint(robot.T_body_lidar)
        self._gyro_noise = _NO_GYRO_RADPS_RTHZ if robot.imu is None else robot.imu.gyro_noise_radps_rthz
        self._grid = RateGrid(rate_hz)
        self._before: tuple[int, Array] | None = None

    def take(self, poses: OdomPoses) -> Iterator[BaseSample]:
        """The samples that are due; the first pose of all gives none, for want of a twist."""
        for k, stamp_ns in enumerate(poses.stamps_ns.tolist()):
            if not self._grid.due(stamp_ns):
                continue
            T_odom_base = se3.from_quat(poses.positions_m[k], poses.quats_xyzw[k]) @ self._T_lidar_base
            before, self._before = self._before, (stamp_ns, T_odom_base)
            if before is not None and before[0] < stamp_ns:
                yield self._sample(before, stamp_ns, T_odom_base)

    def _sample(self, before: tuple[int, Array], stamp_ns: int, T_odom_base: Array) -> BaseSample:
        belief, step_s = self._belief, (stamp_ns - before[0]) * 1e-9
        R = T_odom_base[:3, :3]
        doubt = np.zeros((6, 6))
        doubt[:3, :3] = np.eye(3) * (self._gyro_noise**2 / step_s + _GYRO_BIAS_RADPS**2)
        doubt[3:, 3:] = R.T @ belief.imu.velocity_covariance @ R
        return BaseSample(
            stamp_ns=stamp_ns - belief.offset_ns(),
            T_odom_base=T_odom_base,
            T_map_odom=belief.imu.T_map_odom,
            covariance=self._to_base @ belief.imu.covariance @ self._to_base.T,
            twist=se3.log(se3.inv(before[1]) @ T_odom_base) / step_s,
            doubt=doubt,
            state=belief.state(),
        )
