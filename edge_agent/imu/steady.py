"""An IMU that is never silent: its samples, and what stands in for them while none come.

Whoever integrates asks here for samples over any time and for their noise, and need not know which of them were made.
What made ones say is written in gaps.py; here is when they are made and what is known of the motion then.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu.buffer import ImuBuffer, ImuWindow
from edge_agent.imu.gaps import Gaps, carried_on
from edge_agent.imu.settings import ImuSettings
from edge_agent.imu.state import ImuNoise, NavigationState
from splitslam import se3
from splitslam.robot import Robot
from splitslam.scan import ImuSamples

Array = NDArray[np.float64]


class SteadyImu:
    """One robot's. gaps: where something stands in, how often and how long together."""

    def __init__(self, robot: Robot, settings: ImuSettings) -> None:
        assert robot.imu is not None
        self.gaps = Gaps(robot.imu.rate_hz)
        self._description, self._settings = robot.imu, settings
        self._buffer = ImuBuffer()
        self._gravity_mps2 = robot.gravity_mps2
        self._up_imu = se3.inv(robot.T_lidar_imu)[:3, 2]  # of a robot that stands level
        self._turn: tuple[NavigationState, NavigationState] | None = None

    def __len__(self) -> int:
        """Samples that are kept."""
        return len(self._buffer)

    @property
    def last_ns(self) -> int:
        """Stamp of the newest sample; there must be one."""
        return self._buffer.last_ns

    def append(self, samples: ImuSamples) -> None:
        """Takes samples of the sensor, newer than all that are here, made ones included."""
        self.gaps.seen(samples.stamps_ns)
        self._buffer.append(samples)

    def window(self, start_ns: int, end_ns: int, *also_ns: int) -> ImuWindow:
        """See ImuBuffer."""
        return self._buffer.window(start_ns, end_ns, *also_ns)

    def drop_before(self, stamp_ns: int) -> None:
        """Forgets what is not asked for any more."""
        self._buffer.drop_before(stamp_ns)
        self.gaps.drop_before(stamp_ns)

    def noise(self, start_ns: int, end_ns: int) -> ImuNoise:
        """The samples' noise over a time: the IMU's own, or what a robot may do while it is silent."""
        imu, s = self._description, self._settings
        gyro, accel = self._buffer.noise_densities()
        if self.is_made(start_ns, end_ns):
            root = s.gap_alike_s**0.5
            gyro, accel = max(gyro, s.gap_radps * root), max(accel, s.gap_mps2 * root)
        return ImuNoise(
            max(gyro, imu.gyro_noise_radps_rthz),
            max(accel, imu.accel_noise_mps2_rthz),
            imu.gyro_walk_radps2_rthz,
            imu.accel_walk_mps3_rthz,
        )

    # --- silence ----------------------------------------------------------------------------------------------

    def is_silent(self, until_ns: int) -> bool:
        """Has the IMU said nothing for longer than interpolation may bridge? Asked when `until_ns` is the time."""
        return self.gaps.between(self.last_ns, until_ns)

    def is_made(self, start_ns: int, end_ns: int) -> bool:
        """Does anything stand in for samples between the two times?"""
        return self.gaps.overlap(start_ns, end_ns)

    def turned(self, before: NavigationState, after: NavigationState) -> None:
        """The last two answers: how the robot turned between them it may go on turning while the IMU is silent."""
        self._turn = before, after

    def rate_radps(self) -> Array:
        """(3,) turning rate between the last two answers, frame `imu`; 0 without them."""
        if self._turn is None:
            return np.zeros(3)
        before, after = self._turn
        turn = before.T_odom_imu[:3, :3].T @ after.T_odom_imu[:3, :3]
        return se3.so3_log(turn) / (max(after.stamp_ns - before.stamp_ns, 1) * 1e-9)

    def bridge(self, until_ns: int, gyro_after: Array | None, row: Array, bias: Array) -> None:
        """The motion goes on as it was, from state `row` (15,) at the newest sample on.

        gyro_after: (3,) what the gyro said when it came back, None while it is silent. bias: (6,), gyro first.
        """
        rate = self.rate_radps() + bias[:3]
        gyro = (rate, rate) if gyro_after is None else (self._buffer.last_gyro_radps, gyro_after)
        start_ns = self.last_ns
        self._make(carried_on(start_ns, until_ns, gyro, row, bias, self._gravity_mps2))
        self.gaps.remember(start_ns, until_ns)

    def stand(self, stamp_ns: int, until_ns: int, row: Array, bias: Array) -> None:
        """The robot stands as in `row` (15,), of which nothing before `stamp_ns` will be asked for."""
        start_ns, gyro = self.last_ns, bias[:3]
        for rest in ((stamp_ns - 1, stamp_ns), (stamp_ns, until_ns)):
            self._make(carried_on(*rest, (gyro, gyro), row, bias, self._gravity_mps2))
        self.gaps.remember(start_ns, until_ns)

    def stand_level(self, start_ns: int, end_ns: int) -> None:
        """No sample has ever come: the robot is taken to stand level."""
        stamps_ns = np.array([start_ns, end_ns])
        accel = np.tile(self._up_imu * self._gravity_mps2, (2, 1))
        self._make(ImuSamples(stamps_ns, np.zeros((2, 3)), accel))
        self.gaps.remember(start_ns, end_ns)

    def _make(self, samples: ImuSamples) -> None:
        self._buffer.append(samples, made=True)
