"""The filter against the factor graph of the paper, solved as a whole by GTSAM."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, B, V, X

from edge_agent.imu.buffer import ImuWindow
from edge_agent.imu.filter import MotionFilter
from edge_agent.imu.settings import ImuSettings
from edge_agent.imu.state import ImuNoise, NavigationState
from splitslam import se3
from tests import tolerances as bars
from tests.imu.made import SCAN_NS, START_NS, Drive, G

SETTINGS = ImuSettings()
NOISE = ImuNoise(2e-3, 0.02, 2e-5, 2e-4)
TILT_RAD = 0.1


def sigmas(*values: float) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Diagonal.Sigmas(np.repeat(values, 3))


class Graph:
    """All scans since the start, and all that is known of them."""

    def __init__(self, state: NavigationState, T_server_imu: np.ndarray) -> None:
        self.graph, self.values, self.k = gtsam.NonlinearFactorGraph(), gtsam.Values(), 0
        R = state.T_odom_imu[:3, :3]
        covariance = np.diag(np.repeat(1e-6, 6))
        covariance[:3, :3] = R.T @ np.diag([TILT_RAD**2, TILT_RAD**2, 1e-6]) @ R
        pose, bias = gtsam.Pose3(state.T_odom_imu), gtsam.imuBias.ConstantBias(state.bias[3:], state.bias[:3])
        self.graph.add(gtsam.PriorFactorPose3(X(0), pose, gtsam.noiseModel.Gaussian.Covariance(covariance)))
        velocity_noise = gtsam.noiseModel.Isotropic.Sigma(3, state.velocity_sigma_mps)
        self.graph.add(gtsam.PriorFactorVector(V(0), state.velocity_mps, velocity_noise))
        bias_noise = sigmas(SETTINGS.prior_bias_accel_mps2, SETTINGS.prior_bias_gyro_radps)
        self.graph.add(gtsam.PriorFactorConstantBias(B(0), bias, bias_noise))
        self._insert(0, pose, state.velocity_mps, bias, gtsam.Pose3(T_server_imu))

    def _insert(self, k, pose, velocity, bias, server) -> None:
        lidar = sigmas(SETTINGS.lidar_rotation_rad, SETTINGS.lidar_translation_m)
        robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(2.0), lidar)
        self.graph.add(gtsam.BetweenFactorPose3(A(k), X(k), server, robust if k else lidar))
        for key, value in ((X(k), pose), (V(k), velocity), (B(k), bias), (A(k), pose.compose(server.inverse()))):
            self.values.insert(key, value)

    def add(self, T_server_imu: np.ndarray, window: ImuWindow) -> None:
        k = self.k = self.k + 1
        parameters = gtsam.PreintegrationParams.MakeSharedU(G)
        parameters.setAccelerometerCovariance(np.eye(3) * NOISE.accel_mps2_rthz**2)
        parameters.setGyroscopeCovariance(np.eye(3) * NOISE.gyro_radps_rthz**2)
        parameters.setIntegrationCovariance(np.eye(3) * 1e-8)
        bias = self.values.atConstantBias(B(k - 1))
        pim = gtsam.PreintegratedImuMeasurements(parameters, bias)
        mean = (0.5 * (values[1:] + values[:-1]) for values in (window.accel_mps2, window.gyro_radps))
        for accel, gyro, ns in zip(*mean, np.diff(window.stamps_ns), strict=True):
            pim.integrateMeasurement(accel, gyro, ns * 1e-9)
        seconds = pim.deltaTij()
        walk = gtsam.noiseModel.Diagonal.Sigmas(np.sqrt(seconds) * np.repeat([NOISE.accel_walk, NOISE.gyro_walk], 3))
        drift = np.repeat([SETTINGS.drift_rotation_rad_rts**2, SETTINGS.drift_translation_m_rts**2], 3) * seconds
        to_server = se3.adjoint(T_server_imu)
        bends = gtsam.noiseModel.Gaussian.Covariance(to_server * drift @ to_server.T)
        self.graph.add(gtsam.ImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(k - 1), pim))
        self.graph.add(gtsam.BetweenFactorConstantBias(B(k - 1), B(k), gtsam.imuBias.ConstantBias(), walk))
        self.graph.add(gtsam.BetweenFactorPose3(A(k - 1), A(k), gtsam.Pose3(), bends))
        before = gtsam.NavState(self.values.atPose3(X(k - 1)), self.values.atVector(V(k - 1)))
        guess = pim.predict(before, bias)
        self._insert(k, guess.pose(), guess.velocity(), bias, gtsam.Pose3(T_server_imu))
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setLinearSolverType("MULTIFRONTAL_QR")
        self.values = gtsam.LevenbergMarquardtOptimizer(self.graph, self.values, parameters).optimize()

    def velocity_covariance(self) -> np.ndarray:
        return gtsam.Marginals(self.graph, self.values).marginalCovariance(V(self.k))


def both(drive: Drive, start: NavigationState, scans: int, seed: int = 0) -> tuple[MotionFilter, Graph]:
    """The filter and the graph after the same noisy scans, one of which is far off."""
    rng = np.random.default_rng(seed)
    known = MotionFilter(SETTINGS, G)
    T_server = se3.exp(np.array([0.02, -0.05, 0.4, 3.0, -2.0, 0.5]))

    def answer(k: int) -> np.ndarray:
        noise = rng.normal(size=6) * np.repeat([SETTINGS.lidar_rotation_rad, SETTINGS.lidar_translation_m], 3)
        return T_server @ drive.T_odom_imu(0.1 * k) @ se3.exp(noise * (1.0 if k != 12 else 8.0))

    first = answer(0)
    known.start(start, first, TILT_RAD)
    graph = Graph(start, first)
    for k in range(1, scans + 1):
        stamps_ns = START_NS + (k - 1) * SCAN_NS + np.arange(0, SCAN_NS + 1, 5_000_000)
        values = np.array([np.concatenate(drive.imu((ns - START_NS) * 1e-9)) for ns in stamps_ns])
        values += rng.normal(size=values.shape) * np.repeat([NOISE.gyro_radps_rthz, NOISE.accel_mps2_rthz], 3) * 14.1
        window = ImuWindow(stamps_ns, np.ascontiguousarray(values[:, :3]), np.ascontiguousarray(values[:, 3:]))
        T_server_imu = answer(k)
        known.add(START_NS + k * SCAN_NS, T_server_imu, window, NOISE, np.zeros((0, 6)))
        graph.add(T_server_imu, window)
    return known, graph


def start_at(T_odom_imu: np.ndarray) -> NavigationState:
    return NavigationState(START_NS, T_odom_imu, np.zeros(3), np.zeros(6), np.eye(3) * 100.0, TILT_RAD)


@pytest.mark.parametrize("tilt_rad", [0.0, 0.3], ids=["level", "far from level"])
def test_it_knows_what_the_whole_graph_of_the_paper_knows(tilt_rad):
    drive = Drive(speed_mps=3.0)
    tilted = se3.so3_exp(np.array([tilt_rad, -0.5 * tilt_rad, 0.0]))
    first = drive.T_odom_imu(0.0)
    known, graph = both(drive, start_at(se3.compose(tilted @ first[:3, :3], first[:3, 3])), 30)
    state, k = known.state, graph.k
    bias = graph.values.atConstantBias(B(k))
    sigma_mps = float(np.sqrt(np.trace(graph.velocity_covariance()) / 3))
    difference = se3.inv(graph.values.atPose3(X(k)).matrix()) @ state.T_odom_imu
    assert np.linalg.norm(state.velocity_mps - graph.values.atVector(V(k))) < bars.FILTER_OF_SIGMA * sigma_mps
    assert se3.angle(difference) < bars.FILTER_OF_SIGMA * state.tilt_sigma_rad
    assert np.linalg.norm(state.bias[:3] - bias.gyroscope()) < bars.FILTER_GYRO_BIAS_RADPS
    assert np.linalg.norm(state.bias[3:] - bias.accelerometer()) < bars.FILTER_ACCEL_BIAS_MPS2
    assert state.velocity_sigma_mps == pytest.approx(sigma_mps, rel=bars.FILTER_SIGMA_RATIO)
    true_mps = (drive.T_odom_imu(3.01) - drive.T_odom_imu(2.99))[:3, 3] / 0.02
    assert np.linalg.norm(state.velocity_mps - true_mps) < 3 * np.sqrt(3) * sigma_mps
