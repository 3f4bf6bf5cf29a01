"""The paper's Imu node: IMU-rate continuous T_odom_lidar, bias, and the motion inside each scan.

Three clocks meet here. Samples come at IMU rate and are integrated from the last optimised state; scans ask for the
motion they were taken in; answers of the map service come late and correct the state in the past, after which the
samples since then are integrated again. What leaves the node never jumps (output.py).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import _kernels as kernels
from edge_agent.imu.buffer import ImuBuffer, ImuWindow
from edge_agent.imu.filter import MotionFilter
from edge_agent.imu.gaps import Gaps, carried_on
from edge_agent.imu.levelling import MOVING_TILT_RAD, UNKNOWN_TILT_RAD, level, level_at
from edge_agent.imu.output import ContinuousOutput, no_poses
from edge_agent.imu.rest import Rest
from edge_agent.imu.scan_motion import ScanMotion
from edge_agent.imu.settings import ImuSettings
from edge_agent.imu.state import ImuNoise, NavigationState
from edge_agent.imu.unseen import unseen
from edge_agent.imu.wheel_factor import WheelVelocity
from edge_agent.imu.wheels import WheelAid
from edge_agent.types import OdometryReply, OdomPoses
from splitslam import se3
from splitslam.features import Motion
from splitslam.robot import Robot
from splitslam.scan import ImuSamples, WheelSamples

Array = NDArray[np.float64]
INITIALISING, TRACKING, UNANCHORED = 1, 2, 4
_LEVEL_NS = 100_000_000
_BACK_NS = 2_000_000_000  # before the newest sample a scan may begin that comes after silence
_SILENT_NS = 60_000_000_000  # without a sample: as good as for ever, nobody knows any motion over that
_FIRST_READING_NS = 50_000_000
_NO_TURN = 0, np.eye(3)


class ImuNode:
    """One robot's Imu node; single-threaded, see daemon.py for who calls what when."""

    def __init__(self, robot: Robot, settings: ImuSettings) -> None:
        self.robot, self.settings = robot, settings
        self.T_lidar_imu = robot.T_lidar_imu
        self.T_imu_lidar = se3.inv(robot.T_lidar_imu)
        self.buffer = ImuBuffer()
        self.gaps = Gaps(robot.imu.rate_hz if robot.imu is not None else 100.0)
        self._before = self._after = _NO_TURN  # (stamp_ns, R_odom_imu) of the last two answers
        self.wheels = None if robot.wheels is None else WheelAid(robot, settings)
        self.filter = MotionFilter(settings, robot.gravity_mps2, None if self.wheels is None else self.wheels.factors)
        self.output = ContinuousOutput(settings, self.T_imu_lidar)
        self._scan_motion = ScanMotion(settings, self.T_lidar_imu, self.T_imu_lidar)
        self.T_map_odom = np.eye(4)
        self.state = INITIALISING
        self.covariance = np.eye(6)
        self.resets = 0
        self._rest = Rest()
        self._anchor: NavigationState | None = None
        self._started = False  # the filter has its first scan
        self._blind = False  # no sample has come: nobody knows where down is
        self._answers = 0
        self._live = np.zeros((1, 15))
        self._live_ns = 0
        self._live_P = np.eye(3)  # of the velocity, in `odom`
        self._live_wheel_ns = 0
        self._previous_scan_ns: int | None = None
        self._unseen_ns: int | None = None  # the scan after which none came for so long that the way from it is unknown
        self._tilt_sigma_rad = 0.1

    # --- IMU rate ---------------------------------------------------------------------------------------------

    def add_imu(self, samples: ImuSamples, later: bool = False) -> OdomPoses:
        """Takes samples, newer than all before; returns T_odom_lidar at each of them (none before the first scan).

        later: there are more to come at once, whose poses will have these before them.
        """
        if len(samples) == 0:
            return no_poses()
        if self._anchor is not None and self.gaps.between(self.buffer.last_ns, int(samples.stamps_ns[0])):
            self._go_over_gap(int(samples.stamps_ns[0]) - 1, samples.gyro_radps[0])
        self.gaps.seen(samples.stamps_ns)
        self.buffer.append(samples)
        if self._anchor is None:
            self.buffer.drop_before(self.buffer.last_ns - self._kept_ns)
        if self._anchor is None or later:
            return no_poses()
        poses = self._propagate(int(samples.stamps_ns[-1]))
        self._let_go()
        return poses

    @property
    def _kept_ns(self) -> int:
        """So long samples, poses and the state that an answer may correct are kept without a scan."""
        return int(self.settings.history_s * 1e9)

    def _go_over_gap(self, until_ns: int, gyro_after: Array | None) -> None:
        if until_ns - self.buffer.last_ns > _SILENT_NS:
            self._stand_until(until_ns)
        else:
            self._bridge(until_ns, gyro_after)

    def _stand_until(self, until_ns: int) -> None:
        """All that is said of the robot after so long a silence is that it stands where it was seen last."""
        anchor, start_ns, stamp_ns = self._anchor, self.buffer.last_ns, until_ns - _BACK_NS
        assert anchor is not None
        T_odom_imu = self.T_odom_lidar_at(self._live_ns) @ self.T_lidar_imu
        row = np.concatenate([T_odom_imu[:3, :3].reshape(9), T_odom_imu[:3, 3], np.zeros(3)])
        g, gyro = self.robot.gravity_mps2, anchor.bias[:3]
        for rest in ((stamp_ns - 1, stamp_ns), (stamp_ns, until_ns)):
            self.buffer.append(carried_on(*rest, (gyro, gyro), row, anchor.bias, g), made=True)
        self.gaps.remember(start_ns, until_ns)
        self._live, self._live_ns = row[None], stamp_ns
        self.output.begin(stamp_ns, T_odom_imu)
        self._begin_unseen(stamp_ns, T_odom_imu, np.zeros(3), UNKNOWN_TILT_RAD)

    def _let_go(self) -> None:
        """Without scans nobody asks for what was integrated so far: it is not kept to be integrated again."""
        anchor, stamp_ns = self._anchor, self._live_ns - _BACK_NS
        assert anchor is not None
        if stamp_ns - max(anchor.stamp_ns, self._previous_scan_ns or 0) <= self._kept_ns:
            return
        if stamp_ns - (self._previous_scan_ns or 0) > _SILENT_NS:  # biases have long made up whatever motion there is
            window = self.buffer.window(stamp_ns, self._live_ns)
            T_odom_lidar = level_at(self.T_odom_lidar_at(stamp_ns), window, self.T_lidar_imu[:3, :3])
            self._begin_unseen(stamp_ns, T_odom_lidar @ self.T_lidar_imu, np.zeros(3), MOVING_TILT_RAD)
            return
        window, P = self.buffer.window(anchor.stamp_ns, stamp_ns), anchor.velocity_covariance.copy()
        row = self._integrate(window, _row(anchor), self._wheels_after(anchor), P)[-1]
        T_odom_imu = se3.compose(row[:9].reshape(3, 3), row[9:12])
        self._begin_unseen(stamp_ns, T_odom_imu, row[12:].copy(), MOVING_TILT_RAD)

    def _begin_unseen(self, stamp_ns: int, T_odom_imu: Array, velocity_mps: Array, tilt_sigma_rad: float) -> None:
        """From here on. What came before is forgotten, and with it the way since the last scan; nothing is sure of the
        velocity."""
        anchor = self._anchor
        assert anchor is not None
        self._unseen_ns = self._previous_scan_ns if self._unseen_ns is None else self._unseen_ns
        self._started, self._answers, self._tilt_sigma_rad = False, 0, tilt_sigma_rad
        P = np.eye(3) * self.settings.prior_velocity_mps**2
        self._take(NavigationState(stamp_ns, T_odom_imu, velocity_mps, anchor.bias, P, tilt_sigma_rad))
        self._drop_before(stamp_ns, stamp_ns)

    def _bridge(self, until_ns: int, gyro_after: Array | None) -> None:
        """Fills a gap of the IMU; gyro_after: what it said when it came back, None while it is silent."""
        anchor = self._anchor
        assert anchor is not None
        start_ns, rate = self.buffer.last_ns, self._rate_imu() + anchor.bias[:3]
        gyro = (rate, rate) if gyro_after is None else (self.buffer.last_gyro_radps, gyro_after)
        g = self.robot.gravity_mps2
        self.buffer.append(carried_on(start_ns, until_ns, gyro, self._newest(), anchor.bias, g), made=True)
        self.gaps.remember(start_ns, until_ns)

    def _newest(self) -> Array:
        """State (15,) at the newest sample: poses may lag behind it, see add_imu."""
        if self._live_ns >= self.buffer.last_ns:
            return self._live[0]
        window = self.buffer.window(self._live_ns, self.buffer.last_ns)
        return self._integrate(window, self._live[0], self._live_wheel_ns, self._live_P.copy())[-1]

    def _rate_imu(self) -> Array:
        """(3,) turning rate between the last two answers, rad/s; 0 without them."""
        (before_ns, R_before), (after_ns, R_after) = self._before, self._after
        return se3.so3_log(R_before.T @ R_after) / (max(after_ns - before_ns, 1) * 1e-9)

    def _propagate(self, end_ns: int) -> OdomPoses:
        if end_ns <= self._live_ns:
            return no_poses()
        window = self.buffer.window(self._live_ns, end_ns)
        states = self._integrate(window, self._live[0], self._live_wheel_ns, self._live_P)
        self._live, self._live_ns = states[-1:].copy(), end_ns
        self._live_wheel_ns = self._wheels_read(end_ns)
        return self.output.follow(window.stamps_ns, states)

    @property
    def jumps(self) -> dict[str, float]:
        """See ContinuousOutput."""
        return self.output.jumps

    @property
    def wheels_report(self) -> dict[str, float | None]:
        """What the wheels were good for, the `wheels` of report.json."""
        wheels = self.wheels
        if wheels is None:
            return {"factors": 0, "slips": 0, "scale": None}
        return {"factors": wheels.factors.count, "slips": wheels.slips, "scale": wheels.factors.scale}

    @property
    def velocity_covariance(self) -> Array:
        """(3, 3) in `odom`: doubt of the velocity of the poses that were given out last."""
        return self._live_P

    def T_odom_lidar_at(self, stamp_ns: int) -> Array:
        """The pose (4, 4) that was given out for `stamp_ns`, interpolated between IMU samples."""
        return self.output.at(stamp_ns)

    def add_wheels(self, samples: WheelSamples) -> None:
        """Takes wheel odometry, newer than all before; without the robot file's `wheels` it is not asked."""
        if self.wheels is not None:
            self.wheels.append(samples)

    def _integrate(self, window: ImuWindow, first: Array, wheels_after_ns: int, P: Array) -> Array:
        """States (M, 15) over the window from row `first` on; P (3, 3), of the velocity, is carried along.

        Readings of the wheels newer than `wheels_after_ns` correct the velocity on the way.
        """
        anchor = self._anchor
        assert anchor is not None
        states = np.empty((len(window.stamps_ns), 15))
        states[0] = first
        g = self.robot.gravity_mps2
        kernels.integrate(window.stamps_ns, window.gyro_radps, window.accel_mps2, anchor.bias, g, states)
        if self.wheels is not None:
            start_ns, end_ns = int(window.stamps_ns[0]), int(window.stamps_ns[-1])
            noise = self._noise(start_ns, end_ns).accel_mps2_rthz, (start_ns - anchor.stamp_ns) * 1e-9
            self.wheels.aid(window, states, anchor.bias, wheels_after_ns, noise, P)
        return states

    def _wheels_after(self, state: NavigationState) -> int:
        """Readings up to here are in `state` already; a state without velocity takes the last one before it too."""
        return state.stamp_ns - (0 if self._started else _FIRST_READING_NS)

    def _wheels_read(self, end_ns: int) -> int:
        """Where the readings used so far end: one that comes late, after the IMU has passed it, is used as well."""
        return end_ns if self.wheels is None else min(end_ns, self.wheels.last_ns)

    # --- scans ------------------------------------------------------------------------------------------------

    def motion_over(self, start_ns: int, end_ns: int) -> Motion:
        """The motion of the LiDAR since the previous scan and inside this one, from the newest optimised state."""
        if self._anchor is None:
            self._initialise(start_ns, end_ns)
        elif self.gaps.between(self.buffer.last_ns, end_ns):
            self._go_over_gap(end_ns, None)
            self._propagate(end_ns)
        anchor = self._anchor
        assert anchor is not None
        # a scan may have been answered before the next one is asked for, but the anchor is never newer than that
        previous_ns = start_ns if self._previous_scan_ns is None else max(self._previous_scan_ns, anchor.stamp_ns)
        self._previous_scan_ns = start_ns
        self._drop_before(min(anchor.stamp_ns, self._live_ns) - int(1e8), anchor.stamp_ns)
        window = self.buffer.window(anchor.stamp_ns, end_ns, previous_ns, start_ns)
        P = anchor.velocity_covariance.copy()
        states = self._integrate(window, _row(anchor), self._wheels_after(anchor), P)
        rows = int(window.stamps_ns.searchsorted(previous_ns)), int(window.stamps_ns.searchsorted(start_ns))
        noise = self._noise(anchor.stamp_ns, start_ns)
        if self.wheels is None:
            P += np.eye(3) * noise.accel_mps2_rthz**2 * (start_ns - anchor.stamp_ns) * 1e-9
        tilt_rad = UNKNOWN_TILT_RAD if self.gaps.overlap(previous_ns, end_ns) else anchor.tilt_sigma_rad
        motion = self._scan_motion.of(window, states, rows, anchor.bias, P, noise, (tilt_rad, self._answers >= 2))
        if start_ns - anchor.stamp_ns > self.settings.history_s * 1e9:
            self._go_on_from(start_ns, states[rows[1]], P)
        if self._unseen_ns is not None:
            motion, self._unseen_ns = unseen(motion, (start_ns - self._unseen_ns) * 1e-9), None
        return motion

    def _drop_before(self, samples_ns: int, wheels_ns: int) -> None:
        """Forgets what is not asked for any more."""
        self.buffer.drop_before(samples_ns)
        self.gaps.drop_before(samples_ns)
        if self.wheels is not None:
            self.wheels.drop_before(wheels_ns)

    def _go_on_from(self, stamp_ns: int, row: Array, velocity_covariance: Array) -> None:
        """Nobody has said for long where the robot is: what was integrated so far is not integrated again."""
        anchor = self._anchor
        assert anchor is not None
        T_odom_imu = se3.compose(row[:9].reshape(3, 3), row[9:12])
        self._anchor = replace(
            anchor,
            stamp_ns=stamp_ns,
            T_odom_imu=T_odom_imu,
            velocity_mps=row[12:].copy(),
            velocity_covariance=velocity_covariance,
        )
        self._started = False

    def _noise(self, start_ns: int, end_ns: int) -> ImuNoise:
        """The IMU's noise over a time: its own, or what a robot may do while it is silent."""
        imu, s = self.robot.imu, self.settings
        assert imu is not None
        gyro, accel = self.buffer.noise_densities()
        if self.gaps.overlap(start_ns, end_ns):
            root = s.gap_alike_s**0.5
            gyro, accel = max(gyro, s.gap_radps * root), max(accel, s.gap_mps2 * root)
        return ImuNoise(
            max(gyro, imu.gyro_noise_radps_rthz),
            max(accel, imu.accel_noise_mps2_rthz),
            imu.gyro_walk_radps2_rthz,
            imu.accel_walk_mps3_rthz,
        )

    def _initialise(self, start_ns: int, end_ns: int) -> None:
        """Level the robot by what the accelerometer says so far; nothing is assumed of its velocity."""
        self._blind = len(self.buffer) == 0
        if self._blind:
            self._stand_in(start_ns, end_ns)
        window = self.buffer.window(min(start_ns, self.buffer.last_ns), end_ns)
        R_odom_lidar, sigma_rad = level(window, self.T_lidar_imu[:3, :3], self.robot.gravity_mps2)
        self._tilt_sigma_rad = UNKNOWN_TILT_RAD if self._blind else sigma_rad
        T_odom_imu = se3.compose(R_odom_lidar, np.zeros(3)) @ self.T_lidar_imu
        doubt = np.eye(3) * self.settings.prior_velocity_mps**2, self._tilt_sigma_rad
        self._anchor = NavigationState(start_ns, T_odom_imu, np.zeros(3), np.zeros(6), *doubt)
        self._live, self._live_ns = _row(self._anchor)[None], start_ns
        self._live_P = self._anchor.velocity_covariance.copy()
        self._live_wheel_ns = self._wheels_after(self._anchor)
        self.output.begin(start_ns, T_odom_imu)
        if self.buffer.last_ns > start_ns:
            self._propagate(self.buffer.last_ns)

    def _stand_in(self, start_ns: int, end_ns: int) -> None:
        """No sample has ever come: the robot is taken to stand level, and nothing is sure of that."""
        stamps_ns = np.array([start_ns, end_ns])
        up_imu = self.T_imu_lidar[:3, 2] * self.robot.gravity_mps2
        self.buffer.append(ImuSamples(stamps_ns, np.zeros((2, 3)), np.tile(up_imu, (2, 1))), made=True)
        self.gaps.remember(start_ns, end_ns)

    def _level_late(self, stamp_ns: int) -> bool:
        """The first samples have come after the first scan: level the robot with them, as in motion; its place and
        heading are those of the output. False while they do not cover a scan."""
        end_ns = stamp_ns + _LEVEL_NS
        if self.buffer.last_ns < end_ns or self.gaps.overlap(stamp_ns, end_ns):
            return False
        window = self.buffer.window(stamp_ns, end_ns)
        T_odom_imu = level_at(self.T_odom_lidar_at(stamp_ns), window, self.T_lidar_imu[:3, :3]) @ self.T_lidar_imu
        anchor = self._anchor
        assert anchor is not None
        velocity = T_odom_imu[:3, :3] @ anchor.T_odom_imu[:3, :3].T @ anchor.velocity_mps
        doubt = anchor.velocity_covariance + np.eye(3) * self.settings.no_imu_velocity_mps**2
        self._tilt_sigma_rad, self._blind = MOVING_TILT_RAD, False
        self._anchor = NavigationState(stamp_ns, T_odom_imu, velocity, np.zeros(6), doubt, self._tilt_sigma_rad)
        return True

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
            window = self.buffer.window(anchor.stamp_ns, reply.stamp_ns)
            wheel = self._wheels_at_scan(window)
            noise = self._noise(anchor.stamp_ns, reply.stamp_ns)
            if self.gaps.overlap(anchor.stamp_ns, reply.stamp_ns):
                self._rest.over = True
            rest = self._rest.seen(window)
            self.filter.add(reply.stamp_ns, T_server_imu, window, noise, self._axes_imu(reply), wheel, rest)
            self._before = anchor.stamp_ns, anchor.T_odom_imu[:3, :3]
            self._after = reply.stamp_ns, self.filter.state.T_odom_imu[:3, :3]
            if self.filter.failed:
                self.resets += 1
                self._started = False
                self._answers = 0
                self._restart(reply.stamp_ns, anchor, T_server_imu)
        self._answers += 1
        self._take(self.filter.state)
        self._hear(reply, T_odom_lidar)

    def _hear(self, reply: OdometryReply, T_odom_lidar: Array) -> None:
        self.T_map_odom = reply.T_map_lidar @ se3.inv(T_odom_lidar)
        self.covariance, self.state = reply.covariance, reply.state

    def _axes_imu(self, reply: OdometryReply) -> Array:
        """The unobserved directions (A, 6) of the IMU's pose: the LiDAR's, moved by the extrinsics."""
        axes = reply.degenerate_axes
        return axes @ se3.adjoint(self.T_imu_lidar).T if len(axes) else axes

    def _wheels_at_scan(self, window: ImuWindow) -> WheelVelocity | None:
        if self.wheels is None:
            return None
        state = self.filter.state
        noise = self._noise(int(window.stamps_ns[0]), int(window.stamps_ns[-1]))
        states = np.empty((len(window.stamps_ns), 15))
        states[0] = _row(state)
        g = self.robot.gravity_mps2
        kernels.integrate(window.stamps_ns, window.gyro_radps, window.accel_mps2, state.bias, g, states)
        return self.wheels.at_scan(window, states, state.bias, state.velocity_sigma_mps, noise.accel_mps2_rthz)

    def _start_filter(self, stamp_ns: int, T_server_imu: Array) -> None:
        anchor = self._anchor
        assert anchor is not None
        state = replace(anchor, stamp_ns=stamp_ns, tilt_sigma_rad=self._tilt_sigma_rad)
        self.filter.start(state, T_server_imu, max(self._tilt_sigma_rad, MOVING_TILT_RAD))
        self._started = True

    def _restart(self, stamp_ns: int, anchor: NavigationState, T_server_imu: Array) -> None:
        """After a failure: where the output says the robot is, velocity unknown, biases forgotten."""
        T_odom_imu = self.T_odom_lidar_at(stamp_ns) @ self.T_lidar_imu
        doubt = np.eye(3) * self.settings.prior_velocity_mps**2, self._tilt_sigma_rad
        self._anchor = NavigationState(stamp_ns, T_odom_imu, np.zeros(3), np.zeros(6), *doubt)
        self._start_filter(stamp_ns, T_server_imu)

    def _take(self, state: NavigationState) -> None:
        """Makes `state` the anchor; the output goes on from where it is and closes in on it."""
        if self._live_ns < state.stamp_ns:  # samples are late: the output comes along on the last of them
            self._propagate(state.stamp_ns)
        self._anchor = state
        self._live_P, self._live_wheel_ns = state.velocity_covariance.copy(), self._wheels_after(state)
        window = self.buffer.window(state.stamp_ns, self._live_ns)
        self._live = self._integrate(window, _row(state), self._live_wheel_ns, self._live_P)[-1:].copy()
        self._live_wheel_ns = self._wheels_read(self._live_ns)


def _row(state: NavigationState) -> Array:
    return np.concatenate([state.T_odom_imu[:3, :3].reshape(-1), state.T_odom_imu[:3, 3], state.velocity_mps])
