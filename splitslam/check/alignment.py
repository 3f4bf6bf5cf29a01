"""Where the IMU looks and how late its stamps are, from motion alone: hand-eye calibration against LiDAR odometry.

Two kinds of residuals, solved together by Gauss-Newton with Cauchy weights:
- rotation from pose to pose: log(R_lidar) - R_lidar_imu (integral of the gyro, shifted by the delay, less its bias);
- change of mean velocity over a second: what the positions say, less what the accelerometer and gravity say. It tells
  the mounting about the axis of rotation of a car that only ever turns about one, as soon as it brakes or turns.
What the motion does not show stays as uncertain as it is: the covariance says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.check.coarse import CoarseMatch, thinned
from splitslam.check.imu_track import ImuTrack, bend
from splitslam.check.motion import LidarMotion
from splitslam.check.rotations import hats, increments
from splitslam.scan import ImuSamples

Array = NDArray[np.float64]

_TENT_S = 0.5  # half the width of the window that velocity changes are taken over
_SAME_ERROR_RAD = np.radians(1.0)  # a turn of so much from pose to pose doubles the variance of its measurement
_SLIP_RAD = np.radians(4.0)
_ROBUST_SIGMAS = 2.5
_INFLATION = 2.0  # odometry errors of neighbouring scans are alike: sigmas are larger than counting says
_PRIOR_SIGMAS = np.repeat([3.0, 0.5, 0.05, 0.3, 30.0], [3, 1, 3, 3, 3])  # rad, s, rad/s, m/s2, m/s2
_GRAVITY_SIGMA_MPS2 = 0.1
_ITERATIONS = 15
_STEP_S = 0.004
_PHI, _TAU, _GYRO, _ACCEL, _DOWN = slice(0, 3), 3, slice(4, 7), slice(7, 10), slice(10, 13)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """What the motion says.

    R_lidar_imu: (3, 3). covariance: (3, 3) rad^2 of a small turn about the LiDAR's axes. delay_s: IMU stamps say later
    than it was by so much. gyro_bias_radps, accel_bias_mps2: (3,), frame `imu`. gravity_odom_mps2: (3,) in the frame of
    the poses. explained: share of the LiDAR's turns that the gyro accounts for. slips: turns that it contradicts by
    far, as when LiDAR odometry loses its hold in a fast one.
    """

    R_lidar_imu: Array
    covariance: Array
    delay_s: float
    delay_sigma_s: float
    gyro_bias_radps: Array
    accel_bias_mps2: Array
    gravity_odom_mps2: Array
    explained: float
    slips: int


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    X: Array  # R_lidar_imu
    tau_s: float
    gyro_bias: Array
    accel_bias: Array
    gravity: Array

    def moved(self, d: Array) -> _State:
        return _State(
            se3.so3_exp(d[_PHI]) @ self.X,
            self.tau_s + float(d[_TAU]),
            self.gyro_bias + d[_GYRO],
            self.accel_bias + d[_ACCEL],
            self.gravity + d[_DOWN],
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Felt:
    """What the IMU says of the poses' times at one delay, in its own frame, whatever way it is mounted.

    turns, turns_by_delay: (K - 1, 3) from pose to pose, rad, and rad/s. force (N, 3), by_force (N, 3, 3): see
    ImuTrack.force; force_by_delay (N, 3).
    """

    turns: Array
    turns_by_delay: Array
    force: Array
    by_force: Array
    force_by_delay: Array

    @classmethod
    def of(cls, track: ImuTrack, t_s: Array, lag: int) -> _Felt:
        """t_s: (K,) the poses' times by the IMU's clock."""
        after, before = (increments(track.rotations(t_s + step_s)) for step_s in (_STEP_S, -_STEP_S))
        force, by_force = track.force(t_s, lag)
        later, _ = track.force(t_s + _STEP_S, lag)
        turns = increments(track.rotations(t_s))
        return cls(turns, (after - before) / (2 * _STEP_S), force, by_force, (later - force) / _STEP_S)


class _Problem:
    """The measurements of one stretch of motion."""

    def __init__(self, motion: LidarMotion, samples: ImuSamples, t_lidar_imu_m: Array, gravity_mps2: float) -> None:
        self.samples, self.gravity_mps2 = samples, gravity_mps2
        self.origin_ns = int(samples.stamps_ns[0])
        self.t_s: Array = np.multiply(motion.stamps_ns - self.origin_ns, 1e-9, dtype=np.float64)
        self.dt_s = np.diff(self.t_s)
        self.lag = max(1, round(_TENT_S / float(np.median(self.dt_s))))
        R = motion.T_odom_lidar[:, :3, :3]
        self.turns = increments(R)
        self.turn_scale = np.sqrt(1.0 + np.sum(self.turns**2, axis=1) / _SAME_ERROR_RAD**2)
        self.R_mid = R[self.lag : -self.lag]
        imu_m = motion.T_odom_lidar[:, :3, 3] + R @ t_lidar_imu_m
        self.velocity_change = bend(self.t_s, imu_m, self.lag)
        self.tent_s = 0.5 * (self.t_s[2 * self.lag :] - self.t_s[: -2 * self.lag])
        self._felt: tuple[ImuTrack, float, _Felt] | None = None

    def track(self, gyro_bias: Array) -> ImuTrack:
        return ImuTrack(self.samples, self.origin_ns, gyro_bias)

    def inside(self, track: ImuTrack, tau_s: float) -> NDArray[np.bool_]:
        """(K,) poses whose time the IMU covers, with a margin for the delay still to be found."""
        start_s, end_s = track.span_s
        return (self.t_s + tau_s > start_s + 0.02) & (self.t_s + tau_s < end_s - 0.02)

    def felt(self, track: ImuTrack, tau_s: float) -> _Felt:
        """All places to start have one track and one delay: what does not depend on the mounting is found once."""
        if self._felt is None or self._felt[0] is not track or self._felt[1] != tau_s:
            self._felt = track, tau_s, _Felt.of(track, self.t_s + tau_s, self.lag)
        return self._felt[2]

    def rotation(self, s: _State, track: ImuTrack) -> tuple[Array, Array]:
        """Residuals (N, 3) and their Jacobian (N, 3, 13)."""
        felt = self.felt(track, s.tau_s)
        predicted = felt.turns @ s.X.T
        J = np.zeros((len(predicted), 3, 13))
        J[:, :, _PHI] = hats(predicted)
        J[:, :, _TAU] = -felt.turns_by_delay @ s.X.T
        J[:, :, _GYRO] = s.X * self.dt_s[:, None, None]
        return self.turns - predicted, J

    def velocity(self, s: _State, track: ImuTrack) -> tuple[Array, Array]:
        """Residuals (N, 3) and their Jacobian (N, 3, 13)."""
        X_odom, felt = self.R_mid @ s.X, self.felt(track, s.tau_s)
        measured = felt.force - felt.by_force @ s.accel_bias
        predicted = (X_odom @ measured[:, :, None])[:, :, 0] + self.tent_s[:, None] * s.gravity
        J = np.zeros((len(predicted), 3, 13))
        J[:, :, _PHI] = self.R_mid @ hats(measured @ s.X.T)
        J[:, :, _TAU] = -(X_odom @ felt.force_by_delay[:, :, None])[:, :, 0]
        J[:, :, _ACCEL] = X_odom @ felt.by_force
        J[:, :, _DOWN] = -self.tent_s[:, None, None] * np.eye(3)
        return self.velocity_change - predicted, J

    def agreement(self, s: _State, track: ImuTrack) -> tuple[float, int]:
        """Share of the faster half of the turns that the gyro accounts for, and how many it contradicts grossly."""
        good = self.inside(track, s.tau_s)
        left = np.linalg.norm(self.rotation(s, track)[0], axis=1)[good[1:] & good[:-1]]
        turn = np.linalg.norm(self.turns, axis=1)[good[1:] & good[:-1]]
        fast = turn >= np.median(turn)
        fits = left < turn / 3.0 + _SAME_ERROR_RAD / 10.0
        return float(np.mean(fits[fast])), int(np.count_nonzero(left > _SLIP_RAD))

    def normal_equations(self, s: _State, track: ImuTrack) -> tuple[Array, Array, float]:
        """H (13, 13), gradient (13,), robust cost."""
        H = np.diag(_PRIOR_SIGMAS**-2.0)
        g = np.zeros(13)
        g[_GYRO] = s.gyro_bias / _PRIOR_SIGMAS[_GYRO] ** 2
        g[_ACCEL] = s.accel_bias / _PRIOR_SIGMAS[_ACCEL] ** 2
        size = float(np.linalg.norm(s.gravity))
        down = s.gravity / max(size, 1e-6) / _GRAVITY_SIGMA_MPS2
        H[_DOWN, _DOWN] += np.outer(down, down)
        g[_DOWN] += down * (size - self.gravity_mps2) / _GRAVITY_SIGMA_MPS2
        good = self.inside(track, s.tau_s)
        r, J = self.rotation(s, track)
        cost = _accumulate(r, J, self.turn_scale, (good[1:] & good[:-1]).astype(float), 1e-4, H, g)
        r, J = self.velocity(s, track)
        share = (good[2 * self.lag :] & good[: -2 * self.lag]) / (2.0 * self.lag)  # windows overlap
        cost += _accumulate(r, J, self.tent_s, share, 0.02, H, g)
        return H, g, cost


def _accumulate(r: Array, J: Array, scale: Array, share: Array, floor: float, H: Array, g: Array) -> float:
    """Adds residuals (N, 3) of sigma scale x (their own median spread, at least `floor`); returns their cost."""
    size = np.linalg.norm(r, axis=1) / scale
    if not share.any():
        return 0.0
    spread = max(float(np.median(size[share > 0])) / 1.54, floor)  # 1.54: median norm of three unit normals
    ratio = (size / (_ROBUST_SIGMAS * spread)) ** 2
    weight = share / (1.0 + ratio) / (scale * spread) ** 2
    H += np.einsum("k,kia,kib->ab", weight, J, J)
    g += np.einsum("k,kia,ki->a", weight, J, r)
    return float(np.sum(share * (_ROBUST_SIGMAS**2 * np.log1p(ratio) + 6.0 * np.log(spread))))


def align(
    motion: LidarMotion, samples: ImuSamples, T_lidar_imu: Array, gravity_mps2: float, coarse: CoarseMatch
) -> Alignment | None:
    """Mounting and delay of the IMU; None when there is too little motion to look at.

    T_lidar_imu: (4, 4) of the robot file; its translation is used as it is, its rotation only as one place to start.
    """
    problem = _Problem(motion, thinned(samples), T_lidar_imu[:3, 3], gravity_mps2)
    if len(problem.R_mid) < 10:
        return None
    track = problem.track(np.zeros(3))
    state = min(
        (_begin(problem, track, X, coarse.delay_s) for X in _candidates(problem, track, T_lidar_imu, coarse.delay_s)),
        key=lambda begun: begun[0],
    )[1]
    for _ in range(_ITERATIONS):
        H, g, _ = problem.normal_equations(state, track)
        d: Array = np.negative(np.linalg.solve(H, g), dtype=np.float64)
        d *= min(1.0, 0.5 / np.linalg.norm(d[_PHI]), 0.05 / abs(d[_TAU]))
        state = state.moved(d)
        track = problem.track(state.gyro_bias)
        if np.abs(d[:4]).max() < 1e-6:
            break
    H = problem.normal_equations(state, track)[0]
    C = _INFLATION**2 * np.linalg.inv(H)
    explained, slips = problem.agreement(state, track)
    return Alignment(
        R_lidar_imu=state.X,
        covariance=np.asarray(C[_PHI, _PHI], np.float64),
        delay_s=state.tau_s,
        delay_sigma_s=float(np.sqrt(C[_TAU, _TAU])),
        gyro_bias_radps=state.gyro_bias,
        accel_bias_mps2=state.accel_bias,
        gravity_odom_mps2=state.gravity,
        explained=explained,
        slips=slips,
    )


def _candidates(problem: _Problem, track: ImuTrack, T_lidar_imu: Array, tau_s: float) -> list[Array]:
    """Places to start: the best rotation of turns onto turns, and others that agree with it about the main axis."""
    good = problem.inside(track, tau_s)
    pairs = good[1:] & good[:-1]
    M = problem.turns[pairs].T @ problem.felt(track, tau_s).turns[pairs]
    size = float(np.linalg.norm(M))
    best, near_file = _rotation_nearest(M), _rotation_nearest(M + 0.1 * size * T_lidar_imu[:3, :3])
    axis = np.linalg.svd(M)[0][:, 0]
    around = [se3.so3_exp(axis * np.radians(angle)) @ near_file for angle in range(0, 360, 30)]
    return [best, T_lidar_imu[:3, :3], *around]


def _rotation_nearest(M: Array) -> Array:
    """argmax of trace(X^T M) over rotations (Kabsch)."""
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


def _begin(problem: _Problem, track: ImuTrack, X: Array, tau_s: float) -> tuple[float, _State]:
    """Cost of a start with the gravity and biases that fit it best."""
    force = problem.felt(track, tau_s).force
    unexplained = problem.velocity_change - (problem.R_mid @ X @ force[:, :, None])[:, :, 0]
    gravity = np.median(unexplained / problem.tent_s[:, None], axis=0)
    gravity *= problem.gravity_mps2 / max(float(np.linalg.norm(gravity)), 1e-6)
    state = _State(X, tau_s, np.zeros(3), np.zeros(3), gravity)
    for _ in range(3):  # biases and gravity alone
        H, g, _ = problem.normal_equations(state, track)
        d = np.zeros(13)
        d[4:] = -np.linalg.solve(H[4:, 4:], g[4:])
        d[_GYRO] = 0.0  # the track is integrated with none
        state = state.moved(d)
    return problem.normal_equations(state, track)[2], state
