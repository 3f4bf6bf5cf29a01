"""Drives made of poses alone: a tracker that is told what it sees, so that kilometres cost a second."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np

from map_service.loops import LoopJob, LoopResult
from map_service.pipeline import MapPipeline
from map_service.settings import PipelineSettings, TrackerSettings
from map_service.tracker import Track, Tracker
from map_service.tracker_state import TrackerState
from map_service.types import CorrectionRecord, Snapshot, State
from splitslam import se3
from splitslam.alignment import umeyama
from splitslam.features import FeatureFrame, FeatureSet, Knots, Motion
from splitslam.registration.align import RegistrationResult
from splitslam.robot import Gnss, Robot
from splitslam.scan import GnssFix
from splitslam.sim.gnss import enu_to_wgs84

DATUM = (35.5, 139.6, 30.0)
KNOTS = Knots(np.array([0, 100_000_000]), np.zeros((2, 3)), np.zeros((2, 3)))
POINTS = FeatureSet(
    np.array([[5.0, 0, 0], [0, 5, 0], [0, 0, 5]], np.float32), np.zeros(3, np.uint8), np.zeros(3, np.uint16),
    np.zeros(3, np.int32), np.zeros(3, np.uint8),
)  # fmt: skip
DOWN = np.array([0.0, 0.0, -1.0])
Fault = Callable[[float], np.ndarray]  # time s -> (3,) m to add in `enu`


@dataclass(frozen=True)
class Odometry:
    """drift: (6,) tangent that each metre is wrong by; sigmas: what it claims for one scan, rad and m."""

    drift: tuple[float, ...] = (0.0,) * 6
    sigmas: tuple[float, float] = (2e-4, 1e-3)
    first_tilt_rad: float = 0.0


@dataclass(frozen=True)
class Receiver:
    """rate_hz; sigma_m claimed (None: does not say); slow_m: Gauss-Markov of 30 s; white_m; lever_m as it is."""

    rate_hz: float = 5.0
    sigma_m: float | None = 0.5
    slow_m: float = 0.5
    white_m: float = 0.1
    lever_m: tuple[float, float, float] = (0.0, 0.0, 0.3)
    status: int = 0
    seed: int = 1


@dataclass(frozen=True)
class Outcome:
    """online: (n, 4, 4) T_map_lidar as answered, and its covariances (n, 6, 6); final: (n, 4, 4); corrections as
    reported."""

    pipeline: MapPipeline
    truth: np.ndarray
    online: np.ndarray
    final: np.ndarray
    corrections: list[CorrectionRecord]
    covariances: np.ndarray

    def moved_m(self, other: Outcome) -> float:
        """The largest difference between what two runs answered."""
        return float(np.linalg.norm(self.online[:, :3, 3] - other.online[:, :3, 3], axis=1).max())

    def ate_m(self, poses: np.ndarray) -> float:
        """RMSE of the positions after SE(3) alignment."""
        a, b = poses[:, :3, 3], self.truth[:, :3, 3]
        T = umeyama(a, b)
        return float(np.sqrt(np.mean(np.sum((a @ T[:3, :3].T + T[:3, 3] - b) ** 2, axis=1))))

    def errors_m(self, poses: np.ndarray) -> np.ndarray:
        """(n,): distance to the truth; both begin at the same pose."""
        return np.linalg.norm(poses[:, :3, 3] - self.truth[:, :3, 3], axis=1)


def rounds(length_m: float, speed_mps: float, rate_hz: float = 5.0, radius_m: float = 40.0) -> np.ndarray:
    """(n, 4, 4): T_map_lidar of a drive round a circle, level."""
    step_m = speed_mps / rate_hz
    step = se3.exp(np.array([0, 0, step_m / radius_m, step_m, 0, 0]))
    poses = [np.eye(4)]
    for _ in range(int(length_m / step_m)):
        poses.append(poses[-1] @ step)
    return np.array(poses)


def ahead(length_m: float, speed_mps: float, rate_hz: float = 5.0) -> np.ndarray:
    """(n, 4, 4): straight on, weaving a little."""
    step_m = speed_mps / rate_hz
    poses = [np.eye(4)]
    for k in range(int(length_m / step_m)):
        turn = 0.3 * np.cos(k * step_m / 15.0) * step_m / 15.0
        poses.append(poses[-1] @ se3.exp(np.array([0, 0, turn, step_m, 0, 0])))
    return np.array(poses)


class ToldTracker(Tracker):
    """Takes the frame's motion for what it registered."""

    def __init__(self, odometry: Odometry) -> None:
        super().__init__(TrackerSettings(), redeskew=False)
        self._covariance = np.diag(np.repeat(np.square(odometry.sigmas), 3))

    def process(self, frame: FeatureFrame) -> Track:
        points = frame.corners.points_lidar, frame.surfs.points_lidar
        if self.state is None:
            T = se3.compose(se3.level_rotation(-frame.motion.gravity_lidar), np.zeros(3))
            self.state = TrackerState(T, T, frame.stamp_ns, 1, np.zeros(6), np.zeros(6), 0, frame.seq)
            return Track(T, None, State.TRACKING, True, *points)
        T = self.state.T_local_lidar @ frame.motion.T_prev_lidar
        keyframe = bool(np.linalg.norm((se3.inv(self.state.T_local_keyframe) @ T)[:3, 3]) > self.settings.keyframe_m)
        self.state = replace(
            self.state, T_local_lidar=T, stamp_ns=frame.stamp_ns, seq=frame.seq,
            T_local_keyframe=T if keyframe else self.state.T_local_keyframe,
        )  # fmt: skip
        result = RegistrationResult(
            T, np.eye(6), self._covariance, True, 1, 100, 100, 100, 0.0, np.zeros((0, 6)), np.zeros(6), np.zeros(0, int)
        )
        return Track(T, result, State.TRACKING, keyframe, *points)


class NoVerifier:
    """These drives have no loops."""

    def submit(self, job: LoopJob) -> Future[LoopResult]:
        raise AssertionError("loops are disabled")


def frames(truth: np.ndarray, odometry: Odometry, rate_hz: float = 5.0) -> list[FeatureFrame]:
    """What the edge would send: the motion with its drift; gravity as it is, tilted at the first frame."""
    made = []
    for k, T in enumerate(truth):
        motion = np.eye(4)
        if k:
            motion = se3.inv(truth[k - 1]) @ T
            motion = motion @ se3.exp(np.array(odometry.drift) * float(np.linalg.norm(motion[:3, 3])))
        down = T[:3, :3].T @ DOWN
        if k == 0:
            down = se3.so3_exp(np.array([0.0, odometry.first_tilt_rad, 0.0])) @ down
        sigma_rad = 0.01 + odometry.first_tilt_rad
        told = Motion(motion, np.eye(6) * 1e-6, np.zeros(3), KNOTS, down, sigma_rad if k == 0 else 0.005, True)
        made.append(FeatureFrame(k + 1, round(k / rate_hz * 1e9), True, told, POINTS, POINTS))
    return made


def fixes(
    truth: np.ndarray, receiver: Receiver, fault: Fault = lambda t_s: np.zeros(3), rate_hz: float = 5.0
) -> list[GnssFix]:
    """The receiver's world is turned by 2.2 rad from `map`, and shifted."""
    rng = np.random.default_rng(receiver.seed)
    R_enu_map = se3.so3_exp(np.array([0.0, 0.0, 2.2]))
    duration_s = (len(truth) - 1) / rate_hz
    t_s = np.arange(0.05, duration_s, 1.0 / receiver.rate_hz)
    keep = np.exp(-1.0 / (receiver.rate_hz * 30.0))
    slow, enu = rng.normal(size=3), []
    for t in t_s:
        k = min(int(t * rate_hz), len(truth) - 2)
        T = se3.interpolate(truth[k], truth[k + 1], t * rate_hz - k)
        noise = receiver.slow_m * slow + receiver.white_m * rng.normal(size=3)
        antenna = T[:3, :3] @ np.array(receiver.lever_m) + T[:3, 3]
        enu.append(R_enu_map @ antenna + np.array([120.0, -40.0, 3.0]) + noise * [1, 1, 2] + fault(float(t)))
        slow = keep * slow + np.sqrt(1 - keep**2) * rng.normal(size=3)
    covariance = None if receiver.sigma_m is None else np.diag([1.0, 1.0, 4.0]) * receiver.sigma_m**2
    return [
        GnssFix(round(t * 1e9), float(latitude), float(longitude), float(altitude), covariance, receiver.status)
        for t, (latitude, longitude, altitude) in zip(t_s, enu_to_wgs84(np.array(enu), DATUM), strict=True)
    ]


def driven(
    truth: np.ndarray,
    given: list[GnssFix],
    odometry: Odometry = Odometry(),
    lever_m: tuple[float, float, float] = (0.0, 0.0, 0.3),
    rate_hz: float = 5.0,
    restart_at: int | None = None,
) -> Outcome:
    """Runs the map pipeline; fixes arrive with the frame after them, in the order given.

    restart_at: before this frame the pipeline is lost and made again from what it has committed.
    """
    robot = Robot(imu=None, gnss=Gnss(topic=None, t_lidar_antenna_m=lever_m))
    parts = (robot, PipelineSettings(), NoVerifier(), frozenset({"loops"}), "off")
    pipeline = MapPipeline(*parts)
    pipeline.tracker = ToldTracker(odometry)
    arriving = deque(given)
    online, corrections, covariances = [], [], []
    for index, frame in enumerate(frames(truth, odometry, rate_hz)):
        if index == restart_at:
            snapshot = _committed(pipeline)
            pipeline = MapPipeline.restore(*parts, snapshot)
            told = ToldTracker(odometry)
            told.state, told.local_map = pipeline.tracker.state, pipeline.tracker.local_map
            pipeline.tracker = told
        now = []
        while arriving and arriving[0].stamp_ns <= frame.stamp_ns:
            now.append(arriving.popleft())
        answer = pipeline.process(frame, now)
        online.append(answer.T_map_lidar)
        covariances.append(answer.covariance)
        if answer.correction is not None:
            corrections.append(answer.correction)
    final = np.array([T for *_, T in pipeline.trajectory()])
    return Outcome(pipeline, truth, np.array(online), final, corrections, np.array(covariances))


def _committed(pipeline: MapPipeline) -> Snapshot:
    commit = pipeline.take_commit()
    poses = dict(commit.keyframe_poses)
    keyframes = [replace(k, T_map_lidar=poses.get(k.index, k.T_map_lidar)) for k in commit.keyframes]
    return Snapshot(commit.last_seq, keyframes, commit.factors, commit.tracker, len(commit.frames))
