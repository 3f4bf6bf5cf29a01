"""Dead reckoning: the IMU integrated from a state on, its velocity held by the wheels where a robot has them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import _kernels as kernels
from edge_agent.imu.buffer import ImuWindow
from edge_agent.imu.settings import ImuSettings
from edge_agent.imu.state import NavigationState
from edge_agent.imu.steady import SteadyImu
from edge_agent.imu.wheel_factor import WheelVelocity
from edge_agent.imu.wheels import WheelAid
from splitslam.robot import Robot
from splitslam.scan import WheelSamples

Array = NDArray[np.float64]
_FIRST_READING_NS = 50_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Reckoned:
    """Where it has come to, or begins. row: (15,), see _kernels.py. velocity_covariance: (3, 3) in `odom`.

    wheels_ns: readings of the wheels up to here are in it.
    """

    stamp_ns: int
    row: Array
    velocity_covariance: Array
    wheels_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """states: (M, 15) at the stamps of a window, the first of them given. end: at the last."""

    states: Array
    end: Reckoned


class DeadReckoning:
    """Of one robot. wheels: None where it has none, or where they are not to be used."""

    def __init__(self, robot: Robot, settings: ImuSettings, imu: SteadyImu) -> None:
        self.wheels = None if robot.wheels is None else WheelAid(robot, settings)
        self._imu, self._gravity_mps2 = imu, robot.gravity_mps2

    def begin(self, state: NavigationState, velocity_known: bool) -> Reckoned:
        """At an optimised state, with the wheels' readings in it; without velocity their last one is taken again."""
        wheels_ns = state.stamp_ns - (0 if velocity_known else _FIRST_READING_NS)
        return Reckoned(state.stamp_ns, state.row, state.velocity_covariance, wheels_ns)

    def over(self, window: ImuWindow, start: Reckoned, anchor: NavigationState) -> Leg:
        """Goes on from `start`, which is at the window's begin, with the bias of `anchor`, the last optimised state."""
        states, P = self._integrate(window, start.row, anchor.bias), start.velocity_covariance
        start_ns, end_ns = int(window.stamps_ns[0]), int(window.stamps_ns[-1])
        if self.wheels is None:
            return Leg(states, Reckoned(end_ns, states[-1].copy(), P, end_ns))
        P = P.copy()
        noise = self._imu.noise(start_ns, end_ns).accel_mps2_rthz, (start_ns - anchor.stamp_ns) * 1e-9
        self.wheels.aid(window, states, anchor.bias, start.wheels_ns, noise, P)
        # a reading that comes late, after the IMU has passed it, is used as well
        return Leg(states, Reckoned(end_ns, states[-1].copy(), P, min(end_ns, self.wheels.last_ns)))

    def wheel_velocity(self, window: ImuWindow, state: NavigationState) -> WheelVelocity | None:
        """What the wheels say at the window's end for the filter, whose `state` is at its begin."""
        if self.wheels is None:
            return None
        accel_noise = self._imu.noise(int(window.stamps_ns[0]), int(window.stamps_ns[-1])).accel_mps2_rthz
        states = self._integrate(window, state.row, state.bias)
        return self.wheels.at_scan(window, states, state.bias, state.velocity_sigma_mps, accel_noise)

    def add_wheels(self, samples: WheelSamples) -> None:
        """Takes wheel odometry, newer than all before; without the robot file's `wheels` it is not asked."""
        if self.wheels is not None:
            self.wheels.append(samples)

    def drop_before(self, stamp_ns: int) -> None:
        """Forgets readings of the wheels that are not asked for any more."""
        if self.wheels is not None:
            self.wheels.drop_before(stamp_ns)

    @property
    def report(self) -> dict[str, float | None]:
        """What the wheels were good for, the `wheels` of report.json."""
        if self.wheels is None:
            return {"factors": 0, "slips": 0, "scale": None}
        factors = self.wheels.factors
        return {"factors": factors.count, "slips": self.wheels.slips, "scale": factors.scale}

    def _integrate(self, window: ImuWindow, first: Array, bias: Array) -> Array:
        states = np.empty((len(window.stamps_ns), 15))
        states[0] = first
        kernels.integrate(window.stamps_ns, window.gyro_radps, window.accel_mps2, bias, self._gravity_mps2, states)
        return states
