"""The Imu node's estimator: LiDAR odometry and IMU, with bias (paper, section II-B-1), as an iterated Kalman filter.

The paper's factor graph of this node is a chain: what its last scan says of itself, once all before it are summed up,
is what a filter carries along. The state is T_odom_imu, the velocity in `odom`, the bias, and T_odom_server: the
server's odometry frame seen from `odom`, which lets the filter level itself: with a moving start the server's frame is
not quite gravity-aligned, and forcing its poses on the filter would push the tilt into the accelerometer's bias. With
wheels there is their scale as well.

Errors (N,), in this order: rotation, position and velocity in `odom`, from the left; bias, gyro first; right tangent
of T_odom_server; scale. While the filter is young, those of rotation and velocity at its start follow.

A robot that starts in motion is not level at first, by so much that nothing is linear. So the first scans are kept, and
filtered again from a better start when they say that it was another one (an iterated smoother over them).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import _filter_kernels as kernels
from edge_agent.imu.buffer import ImuWindow
from edge_agent.imu.rest import AtRest
from edge_agent.imu.settings import ImuSettings
from edge_agent.imu.state import ImuNoise, NavigationState
from edge_agent.imu.wheel_factor import WANDER_RTS, WheelFactors, WheelVelocity
from splitslam import se3

Array = NDArray[np.float64]
Residual = tuple[Array, Array]  # (K,) in standard deviations, (K, N) its derivatives
_POSITION_RTS = 1e-4  # m in a root second, of the integration itself
_HUBER = 2.0
_ITERATIONS = 5
_SETTLED = 0.01  # standard deviations
_YOUNG = 20  # scans
_LEVEL_RAD = 0.01  # so well level, all is linear
_BENT_RAD = 0.01
_AGAIN = 5
_ROTATION, _POSITION, _VELOCITY, _BIAS, _SERVER = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 15), slice(15, 21)
_SCALE = 21
_FIRST = (0, 1, 2, 6, 7, 8)  # what is remembered of the start


@dataclass(frozen=True, slots=True, eq=False)
class _Answer:
    """What MotionFilter.add takes, but for the stamp."""

    T_server_imu: Array
    window: ImuWindow
    noise: ImuNoise
    unobserved: Array
    wheel: WheelVelocity | None
    rest: AtRest | None


@dataclass(frozen=True, slots=True, eq=False)
class _Mean:
    """What the filter takes for the state.

    poses (2, 4, 4): T_odom_imu, T_odom_server. rest (10,): velocity, bias, scale of the wheels.
    """

    poses: Array
    rest: Array

    @classmethod
    def of(cls, T_odom_imu: Array, velocity_mps: Array, bias: Array, T_odom_server: Array, scale: float) -> _Mean:
        return cls(np.array([T_odom_imu, T_odom_server]), np.array([*velocity_mps, *bias, scale]))

    @property
    def T_odom_imu(self) -> Array:
        return self.poses[0]

    @property
    def velocity_mps(self) -> Array:
        return self.rest[:3]

    @property
    def bias(self) -> Array:
        return self.rest[3:9]

    @property
    def scale(self) -> float:
        return float(self.rest[9])

    def moved(self, change: Array) -> _Mean:
        """The state that is this one with an error of `change` (N,) taken out."""
        there = _Mean(np.empty_like(self.poses), np.empty_like(self.rest))
        kernels.move(self.poses, self.rest, change, there.poses, there.rest)
        return there


class MotionFilter:
    """`start` begins anew, `add` takes the next scan's answer; `state` is what is known after it."""

    def __init__(self, settings: ImuSettings, gravity_mps2: float, wheels: WheelFactors | None = None) -> None:
        self.settings, self.gravity_mps2, self.wheels = settings, gravity_mps2, wheels
        self._sigmas = np.repeat([settings.lidar_rotation_rad, settings.lidar_translation_m], 3)
        self._whiten_all = np.diag(1.0 / self._sigmas)

    def start(self, state: NavigationState, T_server_imu: Array, tilt_sigma_rad: float) -> None:
        """At a scan whose pose in the server's odometry frame is T_server_imu (4, 4).

        Position and yaw define `odom`, tilt and velocity are as uncertain as they are.
        """
        self._first = state, T_server_imu, tilt_sigma_rad, (0.0 if self.wheels is None else self.wheels.scale)
        self._answers: list[_Answer] = []
        self._begin(np.zeros(len(_FIRST)))
        self.state = state

    def _begin(self, wrong: Array) -> None:
        """The start; wrong (6,): by how much rotation and velocity are taken to have been others than was thought."""
        s, (state, T_server_imu, tilt_sigma_rad, scale) = self.settings, self._first
        n = self._n = _SCALE + (self.wheels is not None)
        P = np.zeros((n, n))
        P[_ROTATION, _ROTATION] = np.diag([tilt_sigma_rad**2, tilt_sigma_rad**2, 1e-6])
        P[_POSITION, _POSITION] = np.eye(3) * 1e-6
        P[_VELOCITY, _VELOCITY] = np.eye(3) * max(state.velocity_sigma_mps, 1e-2) ** 2
        P[_BIAS, _BIAS] = np.diag(np.repeat([s.prior_bias_gyro_radps**2, s.prior_bias_accel_mps2**2], 3))
        if self.wheels is not None:
            P[_SCALE, _SCALE] = self.wheels.scale_sigma**2
        R = se3.so3_exp(wrong[:3]) @ state.T_odom_imu[:3, :3]
        T_odom_imu = se3.compose(R, state.T_odom_imu[:3, 3])
        # the server's frame is where the first pose in it says, but for the noise of that pose
        to_server = se3.adjoint(T_server_imu) @ _to_tangent(T_odom_imu)
        P[_SERVER, :6] = to_server @ P[:6, :6]
        P[:6, _SERVER] = P[_SERVER, :6].T
        P[_SERVER, _SERVER] = to_server @ P[:6, _SERVER]
        P[_SERVER, _SERVER] += _moved(T_server_imu, s.lidar_rotation_rad**2, s.lidar_translation_m**2)
        rows = [*range(n), *_FIRST]
        self._P = P[np.ix_(rows, rows)]
        self._mean = _Mean.of(
            T_odom_imu, state.velocity_mps + wrong[3:], state.bias, T_odom_imu @ se3.inv(T_server_imu), scale
        )
        self._error = np.zeros(n + len(_FIRST))  # what was thought is still as likely as it was
        self._error[list(_FIRST)] = self._error[n:] = -wrong
        self._error[_SERVER] = to_server @ self._error[:6]
        self._wrong = wrong

    def add(
        self,
        stamp_ns: int,
        T_server_imu: Array,
        window: ImuWindow,
        noise: ImuNoise,
        unobserved: Array,
        wheel: WheelVelocity | None = None,
        rest: AtRest | None = None,
    ) -> None:
        """Next scan: its pose in the server's odometry frame, the IMU since the last, wheels, rest; updates `state`.

        unobserved (A, 6): directions, right tangent of the IMU's pose, in which that pose is only a prediction.
        """
        answer = _Answer(T_server_imu, window, noise, unobserved, wheel, rest)
        self._take(answer)
        if self._is_young:
            self._look_back([*self._answers, answer])
        if self.wheels is not None:
            self.wheels.count += wheel is not None
        self._read(stamp_ns)

    def _take(self, answer: _Answer) -> None:
        self._predict(answer)
        whiten = self._whiten(answer.unobserved)
        self._correct(lambda mean: self._pose_residual(mean, answer.T_server_imu, whiten))
        if (wheel := answer.wheel) is not None:
            self._correct(lambda mean: self._wheel_residual(mean, wheel))
        if (rest := answer.rest) is not None:
            self._correct(lambda mean: self._rest_residual(mean, rest))

    @property
    def _is_young(self) -> bool:
        return len(self._P) > self._n

    def _look_back(self, answers: list[_Answer]) -> None:
        """Begins again where the start was not level by what has come since; stops when enough is known."""
        for _ in range(_AGAIN):
            start_error = self._error[self._n :]
            if not np.linalg.norm(start_error[:2]) > _BENT_RAD:
                break
            R = se3.so3_exp(start_error[:3]) @ se3.so3_exp(self._wrong[:3])
            self._begin(np.concatenate([se3.so3_log(R), self._wrong[3:] + start_error[3:]]))
            for answer in answers:
                self._take(answer)
        self._answers = answers
        if len(answers) >= _YOUNG or self._P[:2, :2].trace() < _LEVEL_RAD**2:
            n, self._answers = self._n, []
            self._mean = self._mean.moved(self._error[:n])
            self._P, self._error = self._P[:n, :n].copy(), np.zeros(n)

    def _predict(self, answer: _Answer) -> None:
        """The IMU over the window; meanwhile biases wander, and the server's odometry frame bends: about the robot,
        not about its origin."""
        s, noise, window = self.settings, answer.noise, answer.window
        wander = WANDER_RTS if self.wheels is not None else 0.0
        drift = s.drift_rotation_rad_rts, s.drift_translation_m_rts
        moves = noise.gyro_radps_rthz, _POSITION_RTS, noise.accel_mps2_rthz
        variances = np.array([*moves, noise.gyro_walk, noise.accel_walk, wander, *drift]) ** 2
        imu = window.stamps_ns, window.gyro_radps, window.accel_mps2
        poses, rest = self._mean.poses.copy(), self._mean.rest.copy()
        kernels.predict(imu, answer.T_server_imu, self.gravity_mps2, variances, poses, rest, self._P, self._error)
        self._mean = _Mean(poses, rest)

    def _correct(self, residual: Callable[[_Mean], Residual]) -> None:
        """One measurement, with less weight the more it contradicts (Huber), and relinearised where it leads to.

        While the filter is young the mean stays on the way that the start leads to, and all is linear about that.
        """
        prior, P = self._mean, self._P
        mean, before, weight = prior, np.zeros(len(P)), 1.0
        r, H = residual(prior)
        for _ in range(_ITERATIONS):
            self._P, change = P.copy(), self._error.copy()
            kernels.measure(H, r - H @ before, 1.0 / weight, self._P, change)
            expected = found = r + H @ (change - before)
            if not self._is_young:
                mean, before = prior.moved(change), change
                found, H = residual(mean)
                r = found
            size = float(np.linalg.norm(found))
            wanted = 1.0 if size <= _HUBER else _HUBER / size
            if abs(wanted - weight) < _SETTLED * weight and np.linalg.norm(found - expected) < _SETTLED:
                break
            weight = wanted
        if self._is_young:
            self._error = change
        else:
            self._mean = mean

    def _pose_residual(self, mean: _Mean, T_server_imu: Array, whiten: Array) -> Residual:
        """What is left of inv(T_server_imu) inv(T_odom_server) T_odom_imu, LiDAR odometry: rotation and translation."""
        r, H = np.empty(6), np.empty((6, len(self._P)))
        kernels.pose_residual(mean.poses, T_server_imu, whiten, r, H)
        return r, H

    def _whiten(self, unobserved: Array) -> Array:
        """(6, 6) that makes standard deviations of errors of the LiDAR's pose, right tangent."""
        if not len(unobserved):
            return self._whiten_all
        covariance = np.diag(self._sigmas**2) + self.settings.unobserved_m**2 * unobserved.T @ unobserved
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), np.float64)

    def _wheel_residual(self, mean: _Mean, wheel: WheelVelocity) -> Residual:
        assert self.wheels is not None
        R, columns = mean.T_odom_imu[:3, :3], [0, 1, 2, 6, 7, 8, 9, 10, 11, _SCALE]
        error, derivatives = self.wheels.error(wheel, R, mean.velocity_mps, mean.bias[:3], mean.scale)
        H = np.zeros((len(error), len(self._P)))
        H[:, columns] = derivatives / wheel.sigmas_mps[:, None]
        return error / wheel.sigmas_mps, H

    def _rest_residual(self, mean: _Mean, rest: AtRest) -> Residual:
        """What is left of gravity, as the accelerometer has it: of a robot in rest its tilt and bias are to blame."""
        R = mean.T_odom_imu[:3, :3]
        force = R @ (rest.accel_mps2 - mean.bias[3:])
        H = np.zeros((3, len(self._P)))
        H[:, _ROTATION], H[:, 12:15] = -se3.hat(force), -R
        return (force - [0.0, 0.0, self.gravity_mps2]) / rest.sigma_mps2, H / rest.sigma_mps2

    def _read(self, stamp_ns: int) -> None:
        mean, P = self._mean.moved(self._error[: self._n]), self._P
        (a, b), (_, c) = P[:2, :2].tolist()
        tilt = 0.5 * (a + c) + np.hypot(0.5 * (a - c), b)
        self.state = NavigationState(
            stamp_ns,
            mean.T_odom_imu,
            mean.velocity_mps,
            mean.bias,
            P[_VELOCITY, _VELOCITY].copy(),
            max(float(np.sqrt(tilt)), self.settings.least_tilt_sigma_rad),
        )
        if self.wheels is not None:
            self.wheels.scale, self.wheels.scale_sigma = mean.scale, float(np.sqrt(P[_SCALE, _SCALE]))

    @property
    def failed(self) -> bool:
        """LIO-SAM's failure detection: a velocity or a bias that no robot has."""
        s, state = self.settings, self.state
        return not (
            math.isfinite(state.T_odom_imu.sum())
            and math.hypot(*state.velocity_mps.tolist()) <= s.max_velocity_mps
            and math.hypot(*state.bias[3:].tolist()) <= s.max_bias_accel_mps2
            and math.hypot(*state.bias[:3].tolist()) <= s.max_bias_gyro_radps
        )


def _to_tangent(T_odom_imu: Array) -> Array:
    """(6, 6): errors of rotation and position in `odom` -> right tangent of the pose."""
    back = np.zeros((6, 6))
    back[:3, :3] = back[3:, 3:] = T_odom_imu[:3, :3].T
    return back


def _moved(T_server_imu: Array, rotation_variance: float, translation_variance: float) -> Array:
    """(6, 6) covariance in the server's frame of an error about the robot."""
    to_server = se3.adjoint(T_server_imu)
    return (to_server * np.repeat([rotation_variance, translation_variance], 3)) @ to_server.T
