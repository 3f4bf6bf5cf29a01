"""Walks through made places, mapped by the whole pipeline; only the tracker is replaced by odometry that drifts."""

from __future__ import annotations

import time
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from map_service.loops import LoopJob, LoopResult, verify
from map_service.pipeline import MapPipeline
from map_service.settings import LoopSettings, PipelineSettings, TrackerSettings
from map_service.tracker import Track, Tracker
from map_service.tracker_state import TrackerState
from map_service.types import State
from splitslam import se3
from splitslam.features import FeatureFrame, FeatureSet, Knots, Motion
from splitslam.registration.align import RegistrationResult
from splitslam.robot import Robot
from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place
from splitslam.sim.world import World

STEP_M = 0.9  # from keyframe to keyframe
SECOND = 1_000_000_000
_RINGS, _COLUMNS, _REACH_M, _NOISE_M = 16, 450, 60.0, 0.015
_KNOTS = Knots(np.array([0, SECOND // 10], np.int64), np.zeros((2, 3)), np.zeros((2, 3)))


def town(seed: int) -> World:
    """Houses, walls and posts of many sizes over 160 m x 140 m, none in the streets x or y = -40, 0, 40."""
    rng = np.random.default_rng(seed)
    mesh = Mesh()
    mesh.box((0.0, 0.0, -0.2), (200.0, 200.0, 0.2), reflectivity=30)
    for cx in (-60.0, -20.0, 20.0, 60.0):
        for cy in (-60.0, -20.0, 20.0, 60.0):
            for _ in range(5):
                x, y = rng.uniform(-10.0, 10.0, 2)
                size = rng.uniform((2.0, 2.0, 1.5), (9.0, 9.0, 8.0))
                mesh.box((cx + x, cy + y, 0.0), tuple(size.tolist()), float(rng.uniform(0, 0.3)), reflectivity=60)
            for _ in range(6):
                x, y = rng.uniform(-15.5, 15.5, 2)
                mesh.frustum((cx + x, cy + y, 0.0), (0.15, 0.12), float(rng.uniform(2.0, 6.0)), 8, reflectivity=40)
    return _world(mesh)


def corridors(lanes: tuple[float, ...], length_m: float, module_m: float = 6.0) -> World:
    """Identical corridors along x at y = lanes, each a row of identical modules (door, pillar, beam), joined at both
    ends by cross corridors."""
    mesh = Mesh()
    low, high, half, h = min(lanes), max(lanes), 1.2, 2.8
    middle, width = (low + high) / 2, high - low + 2 * half
    for z in (-0.1, h):
        mesh.box((length_m / 2, middle, z), (length_m + 4 * half, width, 0.1), reflectivity=50)
    for lane in lanes:
        for side in (-1, 1):
            outer = (lane == low and side < 0) or (lane == high and side > 0)
            reach = (-2 * half, length_m + 2 * half) if outer else (0.0, length_m)
            mesh.slab((reach[0], lane + side * half), (reach[1], lane + side * half), 0.0, (0.2, h), reflectivity=60)
        for x in np.arange(0.0, length_m - module_m + 0.1, module_m):
            mesh.box((x + 1.5, lane + half - 0.12, 0.0), (1.0, 0.1, 2.1), reflectivity=40)
            mesh.box((x + 4.0, lane - half + 0.2, 0.0), (0.4, 0.25, h), reflectivity=60)
            mesh.box((x + 5.0, lane, h - 0.1), (0.2, 2 * half, 0.1), reflectivity=60)
    for x in (-2 * half, length_m + 2 * half):
        mesh.slab((x, low - half), (x, high + half), 0.0, (0.2, h), reflectivity=60)
    return _world(mesh)


def _world(mesh: Mesh) -> World:
    triangles, reflectivity = mesh.arrays()
    return World(Place(triangles, reflectivity, lambda x, y: np.zeros_like(x), ()))


def along(corners: list[tuple[float, float]], height_m: float = 1.2) -> list[np.ndarray]:
    """T_world_lidar every STEP_M of the way from corner to corner, looking ahead."""
    points = np.array(corners, float)
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    poses = []
    for at in np.arange(0.0, starts[-1], STEP_M):
        k = min(int(np.searchsorted(starts, at, side="right")) - 1, len(lengths) - 1)
        ahead = (points[k + 1] - points[k]) / lengths[k]
        x, y = points[k] + (at - starts[k]) * ahead
        poses.append(
            se3.compose(se3.so3_exp(np.array([0, 0, np.arctan2(ahead[1], ahead[0])])), np.array([x, y, height_m]))
        )
    return poses


def scan(world: World, T_world_lidar: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What a 16-ring sensor sees, (N, 3), m, frame `lidar`; a third of the points, as features are."""
    elevation, azimuth = np.meshgrid(
        np.radians(np.linspace(-15, 15, _RINGS)), np.linspace(0, 2 * np.pi, _COLUMNS, endpoint=False), indexing="ij"
    )
    rays = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)
    rays = rays[rng.random(len(rays)) < 0.4]
    range_m = world.cast(np.tile(T_world_lidar[:3, 3], (len(rays), 1)), rays @ T_world_lidar[:3, :3].T).range_m
    seen = (range_m < _REACH_M) & (range_m > 0.5)
    return rays[seen] * (range_m[seen] + rng.normal(0, _NOISE_M, int(seen.sum())))[:, None]


class DriftingTracker(Tracker):
    """Its pose is the truth with an error that grows by `drift` (6,) each metre."""

    def __init__(self, truth: list[np.ndarray], drift: np.ndarray) -> None:
        super().__init__(TrackerSettings(), redeskew=False)
        self._truth, self._drift = truth, drift

    def process(self, frame: FeatureFrame) -> Track:
        k = frame.seq - 1
        if self.state is None:
            T, result = self._truth[0], None
        else:
            motion = se3.inv(self._truth[k - 1]) @ self._truth[k]
            T = self.state.T_local_lidar @ motion @ se3.exp(self._drift * float(np.linalg.norm(motion[:3, 3])))
            none, sure = np.zeros(0, np.int64), np.eye(6) * 1e-6
            result = RegistrationResult(
                T, np.eye(6), sure, True, 1, 0, 0, 0, 0.0, np.zeros((0, 6)), np.zeros(6), none
            )  # fmt: skip
        self.state = TrackerState(T, T, frame.stamp_ns, frame.seq, np.zeros(6), np.zeros(6), 0, frame.seq)
        return Track(T, result, State.TRACKING, True, frame.corners.points_lidar, frame.surfs.points_lidar)

    def insert(self, index: int, *_: object) -> None:
        self.local_map.keyframes.add(index)


class Inline:
    """A verifier that does the job at once."""

    def __init__(self) -> None:
        self.done: list[tuple[LoopJob, LoopResult, float]] = []

    def submit(self, job: LoopJob) -> Future[LoopResult]:
        future: Future[LoopResult] = Future()
        start_s = time.perf_counter()
        future.set_result(verify(job))
        self.done.append((job, future.result(), time.perf_counter() - start_s))
        return future


@dataclass(frozen=True, eq=False)
class Walk:
    """A mapped walk: truth and the pipeline after it."""

    truth: list[np.ndarray]
    pipeline: MapPipeline
    verifier: Inline

    def errors_m(self) -> np.ndarray:
        """(n,) distance of each keyframe from the truth, the first one's pose taken as known."""
        return np.array(
            [np.linalg.norm(a[:3, 3] - b[:3, 3]) for a, b in zip(self.pipeline.graph.poses, self.truth, strict=True)]
        )

    def loop_errors_m(self) -> list[float]:
        """How far apart the truth puts the keyframes of each loop in the graph."""
        return [
            float(np.linalg.norm(self.truth[a][:3, 3] - self.truth[b][:3, 3])) for a, b in self.pipeline.graph.loops
        ]


def walk(
    world: World,
    truth: list[np.ndarray],
    drift: np.ndarray,
    *,
    finish: bool = True,
    loops: dict[str, float] | None = None,
) -> Walk:
    """Maps the walk, a keyframe each STEP_M; results are applied 5 keyframes after their candidate."""
    verifier = Inline()
    settings = PipelineSettings(loops=LoopSettings(**{"apply_after_frames": 5, **(loops or {})}))
    pipeline = MapPipeline(Robot(imu=None, gnss=None), settings, verifier)
    pipeline.tracker = DriftingTracker(truth, drift)
    rng = np.random.default_rng(11)
    for k, T in enumerate(truth):
        pipeline.process(frame(k + 1, scan(world, T, rng), k * SECOND))
    if finish:
        pipeline.finish()
    return Walk(truth, pipeline, verifier)


def frame(seq: int, points_lidar: np.ndarray, stamp_ns: int) -> FeatureFrame:
    """A dense frame of surfs."""
    motion = Motion(np.eye(4), np.eye(6) * 1e-6, np.zeros(3), _KNOTS, np.array([0, 0, -1.0]), 0.02, True)
    return FeatureFrame(seq, stamp_ns, True, motion, _features(np.zeros((0, 3))), _features(points_lidar))


def _features(points: np.ndarray) -> FeatureSet:
    n = len(points)
    return FeatureSet(
        points.astype(np.float32), np.zeros(n, np.uint8), np.zeros(n, np.uint16), np.zeros(n, np.int32),
        np.zeros(n, np.uint8),
    )  # fmt: skip
