"""The Imu node's local factor graph: LiDAR odometry and preintegrated IMU, with bias (paper, section II-B-1).

Keys: X(k) T_odom_imu, V(k) velocity in `odom`, B(k) bias at scan k, and A = T_odom_server: the server's odometry
frame seen from `odom`. A lets the graph level itself: with a moving start the server's frame is not quite
gravity-aligned, and forcing its poses on the graph would push the tilt into the accelerometer's bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, V, X
from numpy.typing import NDArray

from edge_agent.imu.buffer import ImuWindow
from edge_agent.imu.settings import ImuSettings
from edge_agent.imu.wheel_factor import WheelFactors, WheelVelocity
from splitslam import se3

Array = NDArray[np.float64]
_MAX_STEP_NS = 10_000_000


@dataclass(frozen=True, slots=True, eq=False)
class NavigationState:
    """The IMU at `stamp_ns`: T_odom_imu (4, 4), velocity (3,) in `odom`, bias (6,) gyro first, and what is in doubt.

    velocity_covariance: (3, 3) in `odom`.
    """

    stamp_ns: int
    T_odom_imu: Array
    velocity_mps: Array
    bias: Array
    velocity_covariance: Array
    tilt_sigma_rad: float

    @property
    def velocity_sigma_mps(self) -> float:
        """Of one axis, in the mean."""
        return float(np.sqrt(np.trace(self.velocity_covariance) / 3))


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """White noise densities and random walks of the IMU."""

    gyro_radps_rthz: float
    accel_mps2_rthz: float
    gyro_walk: float
    accel_walk: float


def _sigmas(rotation_rad: float, translation_m: float) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Diagonal.Sigmas(np.repeat([rotation_rad, translation_m], 3))


def _robust(model: gtsam.noiseModel.Base) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(2.0), model)


class LocalGraph:
    """iSAM2 over at most `reset_keys` scans; `start` begins anew, `add` appends the next scan."""

    def __init__(self, settings: ImuSettings, gravity_mps2: float, wheels: WheelFactors | None = None) -> None:
        self.settings = settings
        self.gravity_mps2 = gravity_mps2
        self.wheels = wheels

    def start(self, state: NavigationState, T_server_imu: Array, tilt_sigma_rad: float) -> None:
        """First key: position and yaw define `odom`, tilt and velocity are as uncertain as they are."""
        s = self.settings
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        pose = gtsam.Pose3(state.T_odom_imu)
        # the pose prior's tilt axes are those of the IMU; yaw about gravity must stay fixed: rotate the sigmas
        R = state.T_odom_imu[:3, :3]
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = R.T @ np.diag([tilt_sigma_rad**2, tilt_sigma_rad**2, 1e-6]) @ R
        covariance[3:, 3:] = np.eye(3) * 1e-6
        graph.add(gtsam.PriorFactorPose3(X(0), pose, gtsam.noiseModel.Gaussian.Covariance(covariance)))
        velocity_noise = gtsam.noiseModel.Isotropic.Sigma(3, max(state.velocity_sigma_mps, 1e-2))
        graph.add(gtsam.PriorFactorVector(V(0), state.velocity_mps, velocity_noise))
        bias_noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([s.prior_bias_accel_mps2, s.prior_bias_gyro_radps], 3))
        bias = gtsam.imuBias.ConstantBias(state.bias[3:], state.bias[:3])
        graph.add(gtsam.PriorFactorConstantBias(B(0), bias, bias_noise))
        server = gtsam.Pose3(T_server_imu)
        graph.add(gtsam.BetweenFactorPose3(A(0), X(0), server, self._lidar_noise(np.zeros((0, 6)))))
        values.insert(X(0), pose)
        values.insert(V(0), state.velocity_mps)
        values.insert(B(0), bias)
        values.insert(A(0), pose.compose(server.inverse()))
        if self.wheels is not None:
            self.wheels.begin(graph, values, reset=False)
        self._begin(graph, values)
        self.state = state

    def _begin(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(0.01)
        parameters.relinearizeSkip = 1
        # priors of 10 m/s meet IMU factors of 0.1 mm/s: beyond what Cholesky's squared condition number bears
        parameters.setFactorization("QR")
        self.isam = gtsam.ISAM2(parameters)
        self.isam.update(graph, values)
        self.key = 0

    def _lidar_noise(self, unobserved: Array) -> gtsam.noiseModel.Base:
        """unobserved (A, 6): directions, right tangent of the IMU's pose, in which the LiDAR said nothing."""
        s = self.settings
        if not len(unobserved):
            return _robust(_sigmas(s.lidar_rotation_rad, s.lidar_translation_m))
        covariance = np.diag(np.repeat([s.lidar_rotation_rad**2, s.lidar_translation_m**2], 3))
        covariance += s.unobserved_m**2 * unobserved.T @ unobserved
        return _robust(gtsam.noiseModel.Gaussian.Covariance(covariance))

    def _drift(self, T_server_imu: Array, seconds: float) -> gtsam.noiseModel.Base:
        """How the server's odometry frame may have bent in `odom` meanwhile: about the robot, not about its origin."""
        s = self.settings
        rotation, translation = s.drift_rotation_rad_rts**2 * seconds, s.drift_translation_m_rts**2 * seconds
        local = np.diag(np.repeat([rotation, translation], 3))
        to_frame = se3.adjoint(T_server_imu)
        return gtsam.noiseModel.Gaussian.Covariance(to_frame @ local @ to_frame.T)

    def _preintegrate(self, window: ImuWindow, noise: ImuNoise) -> gtsam.PreintegratedImuMeasurements:
        parameters = gtsam.PreintegrationParams.MakeSharedU(self.gravity_mps2)
        parameters.setAccelerometerCovariance(np.eye(3) * noise.accel_mps2_rthz**2)
        parameters.setGyroscopeCovariance(np.eye(3) * noise.gyro_radps_rthz**2)
        parameters.setIntegrationCovariance(np.eye(3) * 1e-8)
        bias = gtsam.imuBias.ConstantBias(self.state.bias[3:], self.state.bias[:3])
        pim = gtsam.PreintegratedImuMeasurements(parameters, bias)
        # a slow IMU's intervals are cut: one step alone would tie position and velocity errors together exactly
        fine = window.subdivided(_MAX_STEP_NS)
        gyro = 0.5 * (fine.gyro_radps[1:] + fine.gyro_radps[:-1])
        accel = 0.5 * (fine.accel_mps2[1:] + fine.accel_mps2[:-1])
        seconds = np.diff(fine.stamps_ns) * 1e-9
        for k in np.flatnonzero(seconds > 0):
            pim.integrateMeasurement(accel[k], gyro[k], seconds[k])
        return pim

    def add(
        self,
        stamp_ns: int,
        T_server_imu: Array,
        window: ImuWindow,
        noise: ImuNoise,
        unobserved: Array,
        wheel: WheelVelocity | None = None,
    ) -> None:
        """Next scan: its pose in the server's odometry frame, the IMU since the last, the wheels; updates `state`.

        unobserved (A, 6): directions in which that pose is only a prediction.
        """
        if self.key + 1 >= self.settings.reset_keys:
            self._reset()
        pim = self._preintegrate(window, noise)
        k = self.key + 1
        seconds = pim.deltaTij()
        walk = gtsam.noiseModel.Diagonal.Sigmas(np.sqrt(seconds) * np.repeat([noise.accel_walk, noise.gyro_walk], 3))
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.add(gtsam.ImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(k - 1), pim))
        graph.add(gtsam.BetweenFactorConstantBias(B(k - 1), B(k), gtsam.imuBias.ConstantBias(), walk))
        server = gtsam.Pose3(T_server_imu)
        graph.add(gtsam.BetweenFactorPose3(A(k), X(k), server, self._lidar_noise(unobserved)))
        graph.add(gtsam.BetweenFactorPose3(A(k - 1), A(k), gtsam.Pose3(), self._drift(T_server_imu, seconds)))
        if self.wheels is not None and wheel is not None:
            self.wheels.add(graph, k, wheel)
        before = gtsam.NavState(gtsam.Pose3(self.state.T_odom_imu), self.state.velocity_mps)
        bias = gtsam.imuBias.ConstantBias(self.state.bias[3:], self.state.bias[:3])
        guess = pim.predict(before, bias)
        values.insert(X(k), guess.pose())
        values.insert(V(k), guess.velocity())
        values.insert(B(k), bias)
        values.insert(A(k), guess.pose().compose(server.inverse()))
        self.isam.update(graph, values)
        self.isam.update()
        self.key = k
        self._read(stamp_ns)

    def _read(self, stamp_ns: int) -> None:
        k = self.key
        estimate = self.isam.calculateEstimateConstantBias(B(k))
        T_odom_imu = self.isam.calculateEstimatePose3(X(k)).matrix()
        R = T_odom_imu[:3, :3]
        tilt = (R @ self.isam.marginalCovariance(X(k))[:3, :3] @ R.T)[:2, :2]
        self.state = NavigationState(
            stamp_ns,
            T_odom_imu,
            np.asarray(self.isam.calculateEstimateVector(V(k))),
            np.concatenate([estimate.gyroscope(), estimate.accelerometer()]),
            np.asarray(self.isam.marginalCovariance(V(k))),
            max(float(np.sqrt(np.linalg.eigvalsh(tilt)[-1])), self.settings.least_tilt_sigma_rad),
        )
        if self.wheels is not None:
            self.wheels.read(self.isam)

    def _reset(self) -> None:
        """LIO-SAM's bound on the graph: start again from the last key with its marginals as priors."""
        k = self.key
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        keys = ((X(k), X(0)), (V(k), V(0)), (B(k), B(0)), (A(k), A(0)))
        noise = [gtsam.noiseModel.Gaussian.Covariance(self.isam.marginalCovariance(old)) for old, _ in keys]
        pose, server = self.isam.calculateEstimatePose3(X(k)), self.isam.calculateEstimatePose3(A(k))
        velocity = self.isam.calculateEstimateVector(V(k))
        bias = self.isam.calculateEstimateConstantBias(B(k))
        graph.add(gtsam.PriorFactorPose3(X(0), pose, noise[0]))
        graph.add(gtsam.PriorFactorVector(V(0), velocity, noise[1]))
        graph.add(gtsam.PriorFactorConstantBias(B(0), bias, noise[2]))
        graph.add(gtsam.PriorFactorPose3(A(0), server, noise[3]))
        values.insert(X(0), pose)
        values.insert(V(0), velocity)
        values.insert(B(0), bias)
        values.insert(A(0), server)
        if self.wheels is not None:
            self.wheels.begin(graph, values, reset=True)
        self._begin(graph, values)

    @property
    def failed(self) -> bool:
        """LIO-SAM's failure detection: a velocity or a bias that no robot has."""
        s, state = self.settings, self.state
        return bool(
            not np.isfinite(state.T_odom_imu).all()
            or np.linalg.norm(state.velocity_mps) > s.max_velocity_mps
            or np.linalg.norm(state.bias[3:]) > s.max_bias_accel_mps2
            or np.linalg.norm(state.bias[:3]) > s.max_bias_gyro_radps
        )
