"""The Imu node of a robot without an IMU: the twist between the last two answers goes on, or the wheels say what it is.

Same interface as ImuNode. `odom` is then the sum of the predicted motions: continuous, and as good as the prediction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu.settings import ImuSettings
from edge_agent.types import OdometryReply, OdomPoses
from splitslam import se3
from splitslam.features import Knots, Motion
from splitslam.robot import Robot
from splitslam.scan import ImuSamples, WheelSamples

Array = NDArray[np.float64]
_KNOTS = 11
_KEPT_SCANS = 200
_KEPT_READINGS = 500
_READINGS_NS = 200_000_000
_GATE_SIGMAS = 3.0  # wheels against the twist of the answers, which is two scans old


class ConstantVelocityNode:
    """Predicts each scan's motion from the two newest answers, and from the wheels' newest readings."""

    def __init__(self, robot: Robot, settings: ImuSettings) -> None:
        self.settings = settings
        self.T_map_odom = np.eye(4)
        self.state = 1
        self.covariance = np.eye(6)
        self.resets = 0
        self._twist = np.zeros(6)  # right tangent a second, frame `lidar`
        self._wheels = robot.wheels
        self._T_lidar_wheel = np.eye(4)
        if robot.wheels is not None:
            self._T_lidar_wheel = se3.inv(robot.T_body_lidar) @ robot.wheels.T_body_wheel
        self._readings: list[tuple[int, Array]] = []  # stamp, (vx, vy, yaw rate) of `wheel`
        self._answers: list[tuple[int, Array]] = []  # stamp, pose in the server's odometry frame
        self._scans: dict[int, Array] = {}  # stamp -> T_odom_lidar
        self._last_ns: int | None = None
        self._slips = 0

    def add_imu(self, samples: ImuSamples, later: bool = False) -> OdomPoses:
        """Ignores samples: there is no IMU, or it is switched off."""
        return OdomPoses(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 4)), np.empty((0, 3)))

    def add_wheels(self, samples: WheelSamples) -> None:
        """Takes wheel odometry, newer than all before."""
        rows = np.column_stack([samples.velocity_mps, samples.yaw_rate_radps])
        self._readings += zip(samples.stamps_ns.tolist(), rows, strict=True)
        del self._readings[:-_KEPT_READINGS]

    @property
    def wheels_report(self) -> dict[str, float | None]:
        """No graph, no factors: the readings go into the prediction."""
        return {"factors": 0, "slips": self._slips, "scale": None}

    def _newest_twist(self, start_ns: int, end_ns: int) -> bool:
        """Puts the mean reading since the previous scan into the twist; False without readings, or when they slip.

        What wheels do not measure stays as the answers have it.
        """
        since_ns = end_ns - _READINGS_NS if self._last_ns is None else self._last_ns
        rows = [row for stamp_ns, row in self._readings if max(since_ns, start_ns - _READINGS_NS) < stamp_ns <= end_ns]
        if self._wheels is None or not rows:
            return False
        vx, vy, yaw_rate = np.mean(rows, axis=0)
        twist = se3.adjoint(se3.inv(self._T_lidar_wheel)) @ self._twist  # of `wheel`
        s = self.settings
        surprise = abs(vx - twist[3]) / s.no_imu_velocity_mps, abs(yaw_rate - twist[2]) / s.no_imu_rate_radps
        if len(self._answers) >= 2 and max(surprise) > _GATE_SIGMAS:
            self._slips += 1
            return False
        twist[2], twist[3] = yaw_rate, vx
        if self._wheels.holonomic:
            twist[4] = vy
        self._twist = se3.adjoint(self._T_lidar_wheel) @ twist
        return True

    @property
    def velocity_covariance(self) -> Array:
        """(3, 3): what a velocity may change between two answers."""
        return np.eye(3) * self.settings.no_imu_velocity_mps**2

    @property
    def jumps(self) -> dict[str, float]:
        """Zero: `odom` is made of predictions alone."""
        return {"odom_max_m": 0.0, "odom_max_deg": 0.0}

    def T_odom_lidar_at(self, stamp_ns: int) -> Array:
        """Pose (4, 4) at a scan, or carried on from the newest scan before `stamp_ns`."""
        if stamp_ns in self._scans:
            return self._scans[stamp_ns]
        before = [s for s in self._scans if s <= stamp_ns]
        if not before:
            return np.eye(4)
        return self._scans[before[-1]] @ se3.exp(self._twist * (stamp_ns - before[-1]) * 1e-9)

    def motion_over(self, start_ns: int, end_ns: int) -> Motion:
        """The motion since the previous scan and inside this one, by the newest twist."""
        interval_s = 0.0 if self._last_ns is None else (start_ns - self._last_ns) * 1e-9
        measured = self._newest_twist(start_ns, end_ns)
        T_prev_lidar = se3.exp(self._twist * interval_s)
        self._scans[start_ns] = np.eye(4) if self._last_ns is None else self._scans[self._last_ns] @ T_prev_lidar
        self._last_ns = start_ns
        if len(self._scans) > _KEPT_SCANS:
            del self._scans[next(iter(self._scans))]
        known = len(self._answers) >= 2
        s = self.settings
        velocity_mps = s.no_imu_velocity_mps if known else s.prior_velocity_mps
        if measured and self._wheels is not None:
            w = self._wheels
            velocity_mps = float(
                np.hypot(w.sideways_mps + w.speed_noise_mps, w.scale * np.linalg.norm(self._twist[3:]))
            )
        rate_radps = s.no_imu_rate_radps
        covariance = np.diag(np.repeat([(rate_radps * interval_s) ** 2, (velocity_mps * interval_s) ** 2], 3) + 1e-8)
        offsets_ns = np.linspace(0, max(end_ns - start_ns, 1), _KNOTS).astype(np.int64)
        steps = [se3.exp(self._twist * float(o) * 1e-9) for o in offsets_ns]
        return Motion(
            T_prev_lidar=T_prev_lidar,
            covariance=covariance,
            velocity_lidar_mps=self._twist[3:].copy(),
            knots=Knots(
                offsets_ns, np.stack([se3.so3_log(T[:3, :3]) for T in steps]), np.stack([T[:3, 3] for T in steps])
            ),
            gravity_lidar=np.array([0.0, 0.0, -1.0]),
            gravity_sigma_rad=0.5,
            velocity_known=known,
        )

    def on_odometry(self, reply: OdometryReply) -> None:
        """Takes an answer; late or rejected ones change nothing."""
        if reply.rejected or (self._answers and reply.stamp_ns <= self._answers[-1][0]):
            return
        pose = se3.inv(reply.T_map_odom) @ reply.T_map_lidar
        self._answers = [*self._answers[-1:], (reply.stamp_ns, pose)]
        if len(self._answers) == 2:
            (a_ns, T_a), (b_ns, T_b) = self._answers
            self._twist = se3.log(se3.inv(T_a) @ T_b) / ((b_ns - a_ns) * 1e-9)
        self.T_map_odom = reply.T_map_lidar @ se3.inv(self.T_odom_lidar_at(reply.stamp_ns))
        self.covariance, self.state = reply.covariance, reply.state
