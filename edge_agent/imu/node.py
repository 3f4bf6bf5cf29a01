"""The paper's Imu node: IMU-rate continuous T_odom_lidar, bias, and the motion inside each scan.

Three clocks meet here. Samples come at IMU rate and are integrated from the last optimised state (reckoning.py); scans
ask for the motion they were taken in; answers of the map service come late and correct the state in the past, after
which the samples since then are integrated again. An IMU that is silent is stood in for (steady.py). What leaves the
node never jumps (output.py).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu.buffer import ImuWindow
from edge_agent.imu.filter import MotionFilter
from edge_agent.imu.gaps import Gaps
from edge_agent.imu.levelling import MOVING_TILT_RAD, UNKNOWN_TILT_RAD, level, level_at
from edge_agent.imu.output import ContinuousOutput, no_poses
from edge_agent.imu.reckoning import DeadReckoning, Leg, Reckoned
from edge_agent.imu.rest import Rest
from edge_agent.imu.scan_motion import ScanMotion
from edge_agent.imu.settings import ImuSettings
from edge_agent.imu.state import ImuNoise, NavigationState, pose_and_velocity
from edge_agent.imu.steady import SteadyImu
from edge_agent.imu.unseen import unseen
from edge_agent.types import OdometryReply, OdomPoses
from splitslam import se3
from splitslam.features import Motion
from splitslam.robot import Robot
from splitslam.scan import ImuSamples, WheelSamples

Array = NDArray[np.float64]
_INITIALISING = 1
_LEVEL_NS = 100_000_000
_BACK_NS = 2_000_000_000  # before the newest sample a scan may begin that comes after silence
_KNOWN_MPS = 0.3  # 1 sigma; beyond, the way of the last two scans tells more of the next one
_SILENT_NS = 60_000_000_000  # without a sample: as good as for ever, nobody knows any motion over that


class ImuNode:
    """One robot's Imu node; single-threaded, see daemon.py for who calls what when."""

    def __init__(self, robot: Robot, settings: ImuSettings) -> None:
        self.robot, self.settings = robot, settings
        self.T_lidar_imu = robot.T_lidar_imu
        self.T_imu_lidar = se3.inv(robot.T_lidar_imu)
        self.imu = SteadyImu(robot, settings)
        self.reckoning = DeadReckoning(robot, settings, self.imu)
        wheels = self.reckoning.wheels
        self.filter = MotionFilter(settings, robot.gravity_mps2, None if wheels is None else wheels.factors)
        self.output = ContinuousOutput(settings, self.T_imu_lidar)
        self._axes_to_imu = se3.adjoint(self.T_imu_lidar).T  # directions of the LiDAR's pose -> of the IMU's
        self._scan_motion = ScanMotion(settings, self.T_lidar_imu, self.T_imu_lidar)
        self._kept_ns = int(settings.history_s * 1e9)  # of samples, poses and states that an answer may yet correct
        self.T_map_odom = np.eye(4)
        self.state = _INITIALISING
        self.covariance = np.eye(6)
        self.resets = 0
        self._rest = Rest()
        self._anchor: NavigationState | None = None
        self._started = False  # the filter has its first scan
        self._blind = False  # no sample has come: nobody knows where down is
        self._answers = 0
        self._velocity_known = False
        self._live = Reckoned(0, np.zeros(15), np.eye(3), 0)  # what the output closes in on
        self._previous_scan_ns: int | None = None
        self._unseen_ns: int | None = None  # the scan after which none came for so long that the way from it is unknown
        self._tilt_sigma_rad = 0.1

    @property
    def gaps(self) -> Gaps:
        """Where the IMU was silent."""
        return self.imu.gaps

    @property
    def jumps(self) -> dict[str, float]:
        """See ContinuousOutput."""
        return self.output.jumps

    @property
    def wheels_report(self) -> dict[str, float | None]:
        """What the wheels were good for, the `wheels` of report.json."""
        return self.reckoning.report

    @property
    def velocity_covariance(self) -> Array:
        """(3, 3) in `odom`: doubt of the velocity of the poses that were given out last."""
        return self._live.velocity_covariance

    def T_odom_lidar_at(self, stamp_ns: int) -> Array:
        """The pose (4, 4) that was given out for `stamp_ns`, interpolated between IMU samples."""
        return self.output.at(stamp_ns)

    # --- IMU rate ---------------------------------------------------------------------------------------------

    def add_imu(self, samples: ImuSamples, later: bool = False) -> OdomPoses:
        """Takes samples, newer than all before; returns T_odom_lidar at each of them (none before the first scan).

        later: there are more to come at once, whose poses will have these before them.
        """
        if len(samples) == 0:
            return no_poses()
        first_ns = int(samples.stamps_ns[0])
        if self._anchor is not None and self.imu.is_silent(first_ns):
            self._go_over_silence(first_ns - 1, samples.gyro_radps[0])
        self.imu.append(samples)
        if self._anchor is None:
            self.imu.drop_before(self.imu.last_ns - self._kept_ns)
        if self._anchor is None or later:
            return no_poses()
        poses = self._propagate(int(samples.stamps_ns[-1]))
        self._let_go()
        return poses

    def add_wheels(self, samples: WheelSamples) -> None:
        """Takes wheel odometry, newer than all before; without the robot file's `wheels` it is not asked."""
        self.reckoning.add_wheels(samples)

    def _propagate(self, end_ns: int) -> OdomPoses:
        if end_ns <= self._live.stamp_ns:
            return no_poses()
        window = self.imu.window(self._live.stamp_ns, end_ns)
        leg = self.reckoning.over(window, self._live, self._known)
        self._live = leg.end
        return self.output.follow(window.stamps_ns, leg.states)

    @property
    def _known(self) -> NavigationState:
        """The anchor, the last optimised state; there is one from the first scan on."""
        assert self._anchor is not None
        return self._anchor

    def _from_anchor(self, window: ImuWindow) -> Leg:
        anchor = self._known
        return self.reckoning.over(window, self.reckoning.begin(anchor, self._started), anchor)

    # --- silence ----------------------------------------------------------------------------------------------

    def _go_over_silence(self, until_ns: int, gyro_after: Array | None) -> None:
        """Of the IMU, whose newest sample is old; gyro_after: what it said when it came back, None: it has not yet."""
        if until_ns - self.imu.last_ns > _SILENT_NS:
            self._stand_until(until_ns)
        else:
            self.imu.bridge(until_ns, gyro_after, self._newest(), self._known.bias)

    def _newest(self) -> Array:
        """State (15,) at the newest sample: poses may lag behind it, see add_imu."""
        if self._live.stamp_ns >= self.imu.last_ns:
            return self._live.row
        window = self.imu.window(self._live.stamp_ns, self.imu.last_ns)
        return self.reckoning.over(window, self._live, self._known).end.row

    def _stand_until(self, until_ns: int) -> None:
        """All that is said of the robot after so long a silence is that it stands where it was seen last."""
        stamp_ns = until_ns - _BACK_NS
        T_odom_imu = self.T_odom_lidar_at(self._live.stamp_ns) @ self.T_lidar_imu
        row = np.concatenate([T_odom_imu[:3, :3].reshape(9), T_odom_imu[:3, 3], np.zeros(3)])
        self.imu.stand(stamp_ns, until_ns, row, self._known.bias)
        self._live = replace(self._live, stamp_ns=stamp_ns, row=row)
        self.output.begin(stamp_ns, T_odom_imu)
        self._begin_unseen(stamp_ns, T_odom_imu, np.zeros(3), UNKNOWN_TILT_RAD)

    def _let_go(self) -> None:
        """Without scans nobody asks for what was integrated so far: it is not kept to be integrated again."""
        anchor, stamp_ns = self._known, self._live.stamp_ns - _BACK_NS
        if stamp_ns - max(anchor.stamp_ns, self._previous_scan_ns or 0) <= self._kept_ns:
            return
        if stamp_ns - (self._previous_scan_ns or 0) > _SILENT_NS:  # biases have long made up whatever motion there is
            window = self.imu.window(stamp_ns, self._live.stamp_ns)
            T_odom_lidar = level_at(self.T_odom_lidar_at(stamp_ns), window, self.T_lidar_imu[:3, :3])
            self._begin_unseen(stamp_ns, T_odom_lidar @ self.T_lidar_imu, np.zeros(3), MOVING_TILT_RAD)
            return
        row = self._from_anchor(self.imu.window(anchor.stamp_ns, stamp_ns)).end.row
        self._begin_unseen(stamp_ns, *pose_and_velocity(row), MOVING_TILT_RAD)

    def _begin_unseen(self, stamp_ns: int, T_odom_imu: Array, velocity_mps: Array, tilt_sigma_rad: float) -> None:
        """From here on. What came before is forgotten, and with it the way since the last scan; nothing is sure of the
        velocity."""
        self._unseen_ns = self._previous_scan_ns if self._unseen_ns is None else self._unseen_ns
        self._started, self._answers, self._velocity_known = False, 0, False
        self._tilt_sigma_rad = tilt_sigma_rad
        self._take(self._unsure(stamp_ns, T_odom_imu, velocity_mps, self._known.bias))
        self.imu.drop_before(stamp_ns)
        self.reckoning.drop_before(stamp_ns)

    # --- scans ------------------------------------------------------------------------------------------------

    def motion_over(self, start_ns: int, end_ns: int) -> Motion:
        """The motion of the LiDAR since the previous scan and inside this one, from the newest optimised state."""
        if self._anchor is None:
            self._initialise(start_ns, end_ns)
        elif self.imu.is_silent(end_ns):
            self._go_over_silence(end_ns, None)
            self._propagate(end_ns)
        anchor = self._known
        # a scan may have been answered before the next one is asked for, but the anchor is never newer than that
        previous_ns = start_ns if self._previous_scan_ns is None else max(self._previous_scan_ns, anchor.stamp_ns)
        self._previous_scan_ns = start_ns
        self.imu.drop_before(min(anchor.stamp_ns, self._live.stamp_ns) - int(1e8))
        self.reckoning.drop_before(anchor.stamp_ns)
        window = self.imu.window(anchor.stamp_ns, end_ns, previous_ns, start_ns)
        leg = self._from_anchor(window)
        rows = int(window.stamps_ns.searchsorted(previous_ns)), int(window.stamps_ns.searchsorted(start_ns))
        noise, P = self.imu.noise(anchor.stamp_ns, start_ns), leg.end.velocity_covariance
        made = self.imu.is_made(anchor.stamp_ns, start_ns)  # that holds the velocity, whatever is down
        if self.reckoning.wheels is None:
            tilt_rad = 0.0 if made else anchor.tilt_sigma_rad
            P = P + self._integrated(noise, tilt_rad, (start_ns - anchor.stamp_ns) * 1e-9)
        self._velocity_known |= self._answers >= 2 and (made or bool(np.linalg.eigvalsh(P)[-1] <= _KNOWN_MPS**2))
        tilt_rad = UNKNOWN_TILT_RAD if self.imu.is_made(previous_ns, end_ns) else anchor.tilt_sigma_rad
        known = tilt_rad, self._velocity_known
        motion = self._scan_motion.of(window, leg.states, rows, anchor.bias, P, noise, known)
        if start_ns - anchor.stamp_ns > self._kept_ns:  # nobody answers: what was integrated so far is not once more
            here = pose_and_velocity(leg.states[rows[1]])
            self._anchor = NavigationState(start_ns, *here, anchor.bias, P, anchor.tilt_sigma_rad)
            self._started = False
        if self._unseen_ns is not None:
            motion, self._unseen_ns = unseen(motion, (start_ns - self._unseen_ns) * 1e-9), None
        return motion

    def _integrated(self, noise: ImuNoise, tilt_sigma_rad: float, over_s: float) -> Array:
        """(3, 3): what integration adds to the variance of a velocity in `odom`: noise, gravity taken for motion."""
        level = (self.robot.gravity_mps2 * tilt_sigma_rad * over_s) ** 2
        return np.diag([level, level, 0.0]) + np.eye(3) * noise.accel_mps2_rthz**2 * over_s

    def _initialise(self, start_ns: int, end_ns: int) -> None:
        """Level the robot by what the accelerometer says so far; nothing is assumed of its velocity."""
        self._blind = len(self.imu) == 0
        if self._blind:
            self.imu.stand_level(start_ns, end_ns)
        window = self.imu.window(min(start_ns, self.imu.last_ns), end_ns)
        R_odom_lidar, sigma_rad = level(window, self.T_lidar_imu[:3, :3], self.robot.gravity_mps2)
        self._tilt_sigma_rad = UNKNOWN_TILT_RAD if self._blind else sigma_rad
        T_odom_imu = se3.compose(R_odom_lidar, np.zeros(3)) @ self.T_lidar_imu
        self._anchor = self._unsure(start_ns, T_odom_imu, np.zeros(3), np.zeros(6))
        self._live = self.reckoning.begin(self._anchor, velocity_known=False)
        self.output.begin(start_ns, T_odom_imu)
        if self.imu.last_ns > start_ns:
            self._propagate(self.imu.last_ns)

    def _level_late(self, stamp_ns: int) -> bool:
        """The first samples have come after the first scan: level the robot with them, as in motion; its place and
        heading are those of the output. False while they do not cover a scan."""
        end_ns = stamp_ns + _LEVEL_NS
        if self.imu.last_ns < end_ns or self.imu.is_made(stamp_ns, end_ns):
            return False
        window = self.imu.window(stamp_ns, end_ns)
        T_odom_imu = level_at(self.T_odom_lidar_at(stamp_ns), window, self.T_lidar_imu[:3, :3]) @ self.T_lidar_imu
        anchor = self._known
        velocity = T_odom_imu[:3, :3] @ anchor.T_odom_imu[:3, :3].T @ anchor.velocity_mps
        doubt = anchor.velocity_covariance + np.eye(3) * self.settings.no_imu_velocity_mps**2
        self._tilt_sigma_rad, self._blind = MOVING_TILT_RAD, False
        self._anchor = NavigationState(stamp_ns, T_odom_imu, velocity, np.zeros(6), doubt, self._tilt_sigma_rad)
        return True

    def _unsure(self, stamp_ns: int, T_odom_imu: Array, velocity_mps: Array, bias: Array) -> NavigationState:
        """A state of whose velocity nothing is sure."""
        P = np.eye(3) * self.settings.prior_velocity_mps**2
        return NavigationState(stamp_ns, T_odom_imu, velocity_mps, bias, P, self._tilt_sigma_rad)

    # --- answers ----------------------------------------------------------------------------------------------

    def on_odometry(self, reply: OdometryReply) -> None:
        """Takes the map service's answer to a scan; late or rejected ones change nothing."""
        anchor = self._anchor
        if anchor is None or reply.rejected:
            return
        if reply.stamp_ns < anchor.stamp_ns or (self._started and reply.stamp_ns == anchor.stamp_ns):
            return
        T_odom_lidar = self.T_odom_lidar_at(reply.stamp_ns)
        T_server_imu = se3.inv(reply.T_map_odom) @ reply.T_map_lidar @ self.T_lidar_imu
        if not self._started and len(reply.degenerate_axes) == 6:  # a pose that was carried knows nothing of the motion
            self._hear(reply, T_odom_lidar)
            return
        if (self._blind and self._level_late(reply.stamp_ns)) or not self._started:
            self._start_filter(reply.stamp_ns, T_server_imu)
        else:
            self._filter(reply, T_server_imu)
        self._answers += 1
        self._take(self.filter.state)
        self._hear(reply, T_odom_lidar)

    def _filter(self, reply: OdometryReply, T_server_imu: Array) -> None:
        anchor, stamp_ns = self._known, reply.stamp_ns
        window = self.imu.window(anchor.stamp_ns, stamp_ns)
        wheel = self.reckoning.wheel_velocity(window, self.filter.state)
        noise = self.imu.noise(anchor.stamp_ns, stamp_ns)
        if self.imu.is_made(anchor.stamp_ns, stamp_ns):
            self._rest.over = True
        rest, axes_imu = self._rest.seen(window), reply.degenerate_axes @ self._axes_to_imu
        self.filter.add(stamp_ns, T_server_imu, window, noise, axes_imu, wheel, rest)
        self.imu.turned(anchor, self.filter.state)
        if self.filter.failed:  # it begins again where the output is, velocity unknown, biases forgotten
            self.resets += 1
            self._answers, self._velocity_known = 0, False
            T_odom_imu = self.T_odom_lidar_at(stamp_ns) @ self.T_lidar_imu
            self._anchor = self._unsure(stamp_ns, T_odom_imu, np.zeros(3), np.zeros(6))
            self._start_filter(stamp_ns, T_server_imu)

    def _start_filter(self, stamp_ns: int, T_server_imu: Array) -> None:
        state = replace(self._known, stamp_ns=stamp_ns, tilt_sigma_rad=self._tilt_sigma_rad)
        self.filter.start(state, T_server_imu, max(self._tilt_sigma_rad, MOVING_TILT_RAD))
        self._started = True

    def _hear(self, reply: OdometryReply, T_odom_lidar: Array) -> None:
        self.T_map_odom = reply.T_map_lidar @ se3.inv(T_odom_lidar)
        self.covariance, self.state = reply.covariance, reply.state

    def _take(self, state: NavigationState) -> None:
        """Makes `state` the anchor; the output goes on from where it is and closes in on it."""
        if self._live.stamp_ns < state.stamp_ns:  # samples are late: the output comes along on the last of them
            self._propagate(state.stamp_ns)
        self._anchor = state
        self._live = self._from_anchor(self.imu.window(state.stamp_ns, self._live.stamp_ns)).end
