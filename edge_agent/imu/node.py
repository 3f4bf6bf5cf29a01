"""The paper's Imu node: IMU-rate continuous T_odom_lidar, bias, and the motion inside each scan.

Three clocks meet here. Samples come at IMU rate and are integrated from the last optimised state; scans ask for the
motion they were taken in; answers of the map service come late and correct the state in the past, after which the
samples since then are integrated again. What leaves the node never jumps: it moves as the IMU says, and closes in on
the corrected state a little with each sample.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import _kernels as kernels
from edge_agent.imu.buffer import ImuBuffer, ImuWindow
from edge_agent.imu.filter import MotionFilter
from edge_agent.imu.gaps import Gaps, carried_on
from edge_agent.imu.history import PoseHistory
from edge_agent.imu.settings import ImuSettings
from edge_agent.imu.state import ImuNoise, NavigationState
from edge_agent.imu.wheel_factor import WheelVelocity
from edge_agent.imu.wheels import WheelAid
from edge_agent.types import OdometryReply, OdomPoses
from splitslam import se3
from splitslam.features import Knots, Motion
from splitslam.robot import Robot
from splitslam.scan import ImuSamples, WheelSamples

Array = NDArray[np.float64]
INITIALISING, TRACKING, UNANCHORED = 1, 2, 4
_STILL_GYRO_RADPS = 0.03
_STILL_SAMPLES = 8  # in the first scan: an IMU of 80 Hz and up can tell
_UNKNOWN_TILT_RAD, _MOVING_TILT_RAD = 0.5, 0.1
_LEVEL_NS = 100_000_000
_FIRST_READING_NS = 50_000_000


class ImuNode:
    """One robot's Imu node; single-threaded, see daemon.py for who calls what when."""

    def __init__(self, robot: Robot, settings: ImuSettings) -> None:
        self.robot, self.settings = robot, settings
        self.T_lidar_imu = robot.T_lidar_imu
        self.T_imu_lidar = se3.inv(robot.T_lidar_imu)
        self.buffer = ImuBuffer()
        self.gaps = Gaps(robot.imu.rate_hz if robot.imu is not None else 100.0)
        self._rate_imu = np.zeros(3)  # as the last two answers have it, rad/s
        self.wheels = None if robot.wheels is None else WheelAid(robot, settings)
        self.filter = MotionFilter(settings, robot.gravity_mps2, None if self.wheels is None else self.wheels.factors)
        self.T_map_odom = np.eye(4)
        self.state = INITIALISING
        self.covariance = np.eye(6)
        self.resets = 0
        self._worst = np.zeros(2)
        self._anchor: NavigationState | None = None
        self._started = False  # the filter has its first scan
        self._blind = False  # no sample has come: nobody knows where down is
        self._answers = 0
        self._live = np.zeros((1, 15))
        self._live_ns = 0
        self._live_P = np.eye(3)  # of the velocity, in `odom`
        self._live_wheel_ns = 0
        self._output = np.eye(4)[:3].reshape(-1)  # T_odom_imu as it was given out, at _live_ns
        self._history = PoseHistory(int(settings.history_s * 1e9))
        limits = settings.blend_time_s, settings.blend_max_radps, settings.blend_max_mps
        self._limits = np.array([*limits, settings.blend_step_rad, settings.blend_step_m])
        self._lever_m = self.T_imu_lidar[:3, 3].copy()
        self._previous_scan_ns: int | None = None
        self._tilt_sigma_rad = 0.1

    # --- IMU rate ---------------------------------------------------------------------------------------------

    def add_imu(self, samples: ImuSamples) -> OdomPoses:
        """Takes samples, newer than all before; returns T_odom_lidar at each of them (none before the first scan)."""
        if len(samples) == 0:
            return _no_poses()
        if self._anchor is not None and self.gaps.between(self.buffer.last_ns, int(samples.stamps_ns[0])):
            self._bridge(int(samples.stamps_ns[0]) - 1, samples.gyro_radps[0])
        self.gaps.seen(samples.stamps_ns)
        self.buffer.append(samples)
        if self._anchor is None:
            return _no_poses()
        return self._propagate(int(samples.stamps_ns[-1]))

    def _bridge(self, until_ns: int, gyro_after: Array | None) -> None:
        """Fills a gap of the IMU; gyro_after: what it said when it came back, None while it is silent."""
        anchor = self._anchor
        assert anchor is not None
        start_ns, rate = self.buffer.last_ns, self._rate_imu + anchor.bias[:3]
        gyro = (rate, rate) if gyro_after is None else (self.buffer.last_gyro_radps, gyro_after)
        g = self.robot.gravity_mps2
        self.buffer.append(carried_on(start_ns, until_ns, gyro, self._live[0], anchor.bias, g), made=True)
        self.gaps.remember(start_ns, until_ns)

    def _propagate(self, end_ns: int) -> OdomPoses:
        if end_ns <= self._live_ns:
            return _no_poses()
        anchor = self._anchor
        assert anchor is not None
        window = self.buffer.window(self._live_ns, end_ns)
        states = self._integrate(window, self._live[0], self._live_wheel_ns, self._live_P)
        wanted, output, poses = np.empty((3, len(states), 12))
        kernels.place(states, wanted)
        output[0] = self._output
        kernels.follow(window.stamps_ns, wanted, self._limits, self._lever_m, output, self._worst)
        kernels.emit(output, self.T_imu_lidar, poses)
        self._live, self._live_ns, self._output = states[-1:].copy(), end_ns, output[-1].copy()
        self._live_wheel_ns = self._wheels_read(end_ns)
        self._history.append(window.stamps_ns[1:], poses[1:])
        return _odom_poses(window.stamps_ns[1:], poses[1:], states[1:, 12:])

    @property
    def jumps(self) -> dict[str, float]:
        """Largest difference between one increment of T_odom_lidar and the IMU's own propagation over it."""
        return {"odom_max_m": float(self._worst[0]), "odom_max_deg": float(np.degrees(self._worst[1]))}

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
        return self._history.at(stamp_ns)

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
            self._bridge(end_ns, None)
            self._propagate(end_ns)
        anchor = self._anchor
        assert anchor is not None
        # a scan may have been answered before the next one is asked for, but the anchor is never newer than that
        previous_ns = start_ns if self._previous_scan_ns is None else max(self._previous_scan_ns, anchor.stamp_ns)
        self._previous_scan_ns = start_ns
        if self.wheels is not None:
            self.wheels.drop_before(anchor.stamp_ns)
        oldest_ns = min(anchor.stamp_ns, self._live_ns) - int(1e8)
        self.buffer.drop_before(oldest_ns)
        self.gaps.drop_before(oldest_ns)
        window = self.buffer.window(anchor.stamp_ns, end_ns)
        window = window.at(np.union1d(window.stamps_ns, [previous_ns, start_ns]))
        stamps, gyro = window.stamps_ns, window.gyro_radps
        P = anchor.velocity_covariance.copy()
        states = self._integrate(window, _row(anchor), self._wheels_after(anchor), P)
        first, here = np.searchsorted(stamps, [previous_ns, start_ns])
        T_start = self._lidar_pose(states[here])
        T_prev_lidar = se3.inv(self._lidar_pose(states[first])) @ T_start
        R = T_start[:3, :3]
        noise = self._noise(anchor.stamp_ns, start_ns)
        if self.wheels is None:
            P += np.eye(3) * noise.accel_mps2_rthz**2 * (start_ns - anchor.stamp_ns) * 1e-9
        covariance = self._motion_covariance((start_ns - previous_ns) * 1e-9, R.T @ P @ R, noise)
        if start_ns - anchor.stamp_ns > self.settings.history_s * 1e9:
            self._go_on_from(start_ns, states[here], P)
        lever = np.cross(gyro[here] - anchor.bias[:3], self.T_imu_lidar[:3, 3])
        velocity = R.T @ states[here, 12:] + self.T_lidar_imu[:3, :3] @ lever
        return Motion(
            T_prev_lidar=T_prev_lidar,
            covariance=covariance,
            velocity_lidar_mps=velocity,
            knots=self._knots(stamps[here:] - start_ns, states[here:]),
            gravity_lidar=-R[2],
            gravity_sigma_rad=_UNKNOWN_TILT_RAD if self.gaps.overlap(previous_ns, end_ns) else anchor.tilt_sigma_rad,
            velocity_known=self._answers >= 2,
        )

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

    def _lidar_pose(self, row: Array) -> Array:
        return se3.compose(row[:9].reshape(3, 3), row[9:12]) @ self.T_imu_lidar

    def _knots(self, offsets_ns: NDArray[np.int64], states: Array) -> Knots:
        imu_poses, poses = np.empty((2, len(states), 12))
        kernels.place(states, imu_poses)
        kernels.emit(imu_poses, self.T_imu_lidar, poses)
        rotation, translation = np.empty((len(states), 3)), np.empty((len(states), 3))
        kernels.knots(poses, rotation, translation)
        return Knots(offsets_ns.astype(np.int64), rotation, translation)

    def _motion_covariance(self, interval_s: float, velocity_lidar: Array, noise: ImuNoise) -> Array:
        """(6, 6) of the motion over an interval; velocity_lidar: (3, 3) covariance of the velocity, frame `lidar`."""
        s = self.settings
        rotation = noise.gyro_radps_rthz**2 * interval_s + (0.1 * s.prior_bias_gyro_radps * interval_s) ** 2
        covariance = np.eye(6) * 1e-8
        covariance[:3, :3] += np.eye(3) * rotation
        covariance[3:, 3:] += (velocity_lidar + np.eye(3) * noise.accel_mps2_rthz**2 * interval_s) * interval_s**2
        return covariance

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
        accel, gyro = window.accel_mps2.mean(axis=0), window.gyro_radps.mean(axis=0)
        g = self.robot.gravity_mps2
        spread = float(np.linalg.norm(window.accel_mps2.std(axis=0)))
        still = (
            len(window.stamps_ns) >= _STILL_SAMPLES and np.linalg.norm(gyro) < _STILL_GYRO_RADPS and spread < 0.05 * g
        )
        excess = abs(float(np.linalg.norm(accel)) - g) / g
        self._tilt_sigma_rad = _UNKNOWN_TILT_RAD if self._blind else max(0.01, excess) if still else _MOVING_TILT_RAD
        up_lidar = self.T_lidar_imu[:3, :3] @ accel
        T_odom_lidar = se3.compose(se3.level_rotation(up_lidar), np.zeros(3))
        bias = np.zeros(6)
        if still:
            bias[:3] = 0.0
        T_odom_imu = T_odom_lidar @ self.T_lidar_imu
        doubt = np.eye(3) * self.settings.prior_velocity_mps**2, self._tilt_sigma_rad
        self._anchor = NavigationState(start_ns, T_odom_imu, np.zeros(3), bias, *doubt)
        self._live, self._live_ns = _row(self._anchor)[None], start_ns
        self._output = T_odom_imu[:3].reshape(-1)
        self._live_P = self._anchor.velocity_covariance.copy()
        self._live_wheel_ns = self._wheels_after(self._anchor)
        self._history.append(np.array([start_ns]), T_odom_lidar[None, :3].reshape(1, 12))
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
        accel = self.buffer.window(stamp_ns, end_ns).accel_mps2.mean(axis=0)
        T = self.T_odom_lidar_at(stamp_ns)
        heading = se3.so3_exp(np.array([0.0, 0.0, np.arctan2(T[1, 0], T[0, 0])]))
        T[:3, :3] = heading @ se3.level_rotation(self.T_lidar_imu[:3, :3] @ accel)
        T_odom_imu, anchor = T @ self.T_lidar_imu, self._anchor
        assert anchor is not None
        velocity = T_odom_imu[:3, :3] @ anchor.T_odom_imu[:3, :3].T @ anchor.velocity_mps
        doubt = anchor.velocity_covariance + np.eye(3) * self.settings.no_imu_velocity_mps**2
        self._tilt_sigma_rad, self._blind = _MOVING_TILT_RAD, False
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
            self.filter.add(reply.stamp_ns, T_server_imu, window, noise, self._axes_imu(reply), wheel)
            turned = anchor.T_odom_imu[:3, :3].T @ self.filter.state.T_odom_imu[:3, :3]
            self._rate_imu = se3.so3_log(turned) / ((reply.stamp_ns - anchor.stamp_ns) * 1e-9)
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
        return reply.degenerate_axes @ se3.adjoint(self.T_imu_lidar).T

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
        self.filter.start(state, T_server_imu, max(self._tilt_sigma_rad, _MOVING_TILT_RAD))
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


def _no_poses() -> OdomPoses:
    return OdomPoses(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 4)), np.empty((0, 3)))


def _odom_poses(stamps_ns: NDArray[np.int64], poses: Array, velocities_mps: Array) -> OdomPoses:
    positions, quats = np.empty((len(poses), 3)), np.empty((len(poses), 4))
    kernels.split(poses, positions, quats)
    return OdomPoses(stamps_ns, positions, quats, velocities_mps.copy())
