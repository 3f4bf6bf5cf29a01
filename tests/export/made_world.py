"""Keyframes in a made world as the service would have them, and what its exact geometry says of a grid's cells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from edge_agent.features.integer import FeatureMarks, Limits
from edge_agent.features.projection import Projector
from edge_agent.features.select import Selector
from edge_agent.settings import FeatureSettings
from map_service.catalog import StoredKeyframe
from map_service.cloud import encode_cloud
from map_service.export import map_pieces
from splitslam import codec
from splitslam.export.grid.settings import GridSettings
from splitslam.features import FeatureFrame, Knots, Motion
from splitslam.maps import MapPiece
from splitslam.scan import Scan
from splitslam.sim.beams import Beams
from splitslam.sim.lidar import ELEVATIONS_DEG
from splitslam.sim.place import Place
from splitslam.sim.spec import DriveSpec
from splitslam.sim.trajectory import Trajectory, drive_trajectory
from splitslam.sim.world import World, make_world

COLUMNS = 1800
NOISE_M = 0.01
ELEVATIONS = np.radians(np.sort(ELEVATIONS_DEG)).astype(np.float32)
_KNOTS = Knots(np.array([0, 100_000_000]), np.zeros((2, 3)), np.zeros((2, 3)))
_STILL = Motion(np.eye(4), np.eye(6) * 1e-6, np.zeros(3), _KNOTS, np.array([0.0, 0.0, -1.0]), 0.01, True)
_SAMPLE_M = 0.02
_SMALL_STEPS = 14
LOW_M = 0.3


@dataclass(frozen=True, eq=False)
class Drive:
    """Keyframes as pieces of a map whose frame is the world's."""

    world: World
    poses: np.ndarray
    pieces: list[MapPiece]


@cache
def driven(spec: DriveSpec, start_s: float, end_s: float, every_m: float = 1.0) -> Drive:
    """The part of a drive; features, codec and store as they are, the sensor stands still for each scan."""
    world = make_world(spec.world)
    trajectory = drive_trajectory(spec, world.place)
    times = _spaced(trajectory, np.arange(start_s, end_s, 0.1), every_m)
    poses = np.array([trajectory.T_world_lidar(t) for t in times])
    camera = Camera(Beams(spec, world, trajectory))
    stored = [StoredKeyframe(k, round(t * 1e9), T, camera.cloud(k, t, T))
              for k, (t, T) in enumerate(zip(times, poses, strict=True))]  # fmt: skip
    return Drive(world, poses, list(map_pieces(stored, 0.0)))


def _spaced(trajectory: Trajectory, times: np.ndarray, every_m: float) -> list[float]:
    _, positions = trajectory.poses(times)
    kept = [0]
    for k in range(len(times)):
        if np.linalg.norm(positions[k] - positions[kept[-1]]) >= every_m:
            kept.append(k)
    return times[kept].tolist()


class Camera:
    """A VLP-16 that takes whole scans at once, and the edge's features of them."""

    def __init__(self, beams: Any) -> None:
        """beams: has Beams' `cast`."""
        self._beams, self._settings = beams, FeatureSettings()
        self._projector = Projector(len(ELEVATIONS), COLUMNS)
        self._selector = Selector(self._settings, len(ELEVATIONS), COLUMNS)
        azimuth = (np.arange(COLUMNS) + 0.5) * (2 * np.pi / COLUMNS)
        level = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(COLUMNS)], axis=1)
        up = np.array([0.0, 0.0, 1.0])
        rays = [np.cos(e) * level + np.sin(e) * up for e in ELEVATIONS.astype(float)]
        self._rays, self._ring = np.concatenate(rays), np.repeat(np.arange(len(ELEVATIONS), dtype=np.uint8), COLUMNS)

    def cloud(self, number: int, time_s: float, T: np.ndarray) -> bytes:
        """A keyframe's cloud as the store has it."""
        n = len(self._rays)
        hits = self._beams.cast(number, np.full(n, time_s), np.tile(T[:3, 3], (n, 1)), self._rays @ T[:3, :3].T)
        range_m = hits.range_m + np.random.default_rng(number).normal(0.0, NOISE_M, n)
        seen = (range_m > 0.5) & (range_m < 100.0) & (hits.strength > 1e-3)
        points = (self._rays[seen] * range_m[seen, None]).astype(np.float32)
        shade = hits.reflectivity[seen].astype(np.uint8)
        scan = Scan(0, 100_000_000, points, np.zeros(len(points), np.int32), self._ring[seen], shade)
        image = self._projector.project(scan)
        assert image.range_q is not None
        marks = FeatureMarks.of(image.range_q, image.column, image.ring_start, Limits.of(self._settings))
        self._selector.find(image, marks, dense=True)
        corners, surfs = self._selector.choose(image, marks, dense=True)
        frame = FeatureFrame(1, 0, True, _STILL, corners, surfs)
        sent = codec.decode(codec.encode(frame, ELEVATIONS, COLUMNS), 1, 0, True, ELEVATIONS)
        c, s = sent.corners, sent.surfs
        return encode_cloud(c.points_lidar, s.points_lidar, c.intensity, s.intensity)


# -- what the geometry says ---------------------------------------------------------------------------------------


def standing_cells(place: Place, low: np.ndarray, shape: tuple[int, int], settings: GridSettings) -> np.ndarray:
    """(R, C) bool: cells that a surface crosses between the two heights over the way; every 2 cm of it is looked at."""
    cells = np.zeros(shape, bool)
    high = low + np.array(shape[::-1]) * settings.resolution_m
    triangles = place.triangles.astype(np.float64)
    flat_low, flat_high = triangles.min(axis=1), triangles.max(axis=1)
    near = ((flat_high[:, :2] >= low) & (flat_low[:, :2] <= high)).all(axis=1)
    over_m = triangles[..., 2] - place.ground_m(triangles[..., 0], triangles[..., 1])
    near &= (over_m.max(axis=1) > settings.min_height_m - 0.5) & (over_m.min(axis=1) < settings.max_height_m + 0.5)
    for points in _sampled(triangles[near]):
        over_m = points[:, 2] - place.ground_m(points[:, 0], points[:, 1])
        points = points[(over_m >= settings.min_height_m) & (over_m <= settings.max_height_m)]
        at = np.floor((points[:, :2] - low) / settings.resolution_m).astype(int)
        at = at[((at >= 0) & (at < shape[::-1])).all(axis=1)]
        cells[at[:, 1], at[:, 0]] = True
    return cells


def _sampled(triangles: np.ndarray) -> Iterator[np.ndarray]:
    """Points (N, 3) of triangles (K, 3, 3), 2 cm apart or less; small triangles together."""
    sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2)
    opposite = (np.argmax(sides, axis=1) + 1) % 3  # the corner between the two shorter sides
    a, b, c = (triangles[np.arange(len(triangles)), (opposite + k) % 3] for k in range(3))
    steps = (np.ceil(np.maximum(*(np.linalg.norm(end - a, axis=1) for end in (b, c))) / _SAMPLE_M)).astype(int) + 1
    small = steps <= _SMALL_STEPS
    for rows in np.array_split(np.flatnonzero(small), max(1, small.sum() // 4000)):
        i, j = _inside(_SMALL_STEPS, _SMALL_STEPS)
        u, v = (b - a)[rows, None], (c - a)[rows, None]
        yield (a[rows, None] + i[:, None] * u + j[:, None] * v).reshape(-1, 3)
    for k in np.flatnonzero(~small).tolist():
        u, v = b[k] - a[k], c[k] - a[k]
        n, m = (int(np.ceil(np.linalg.norm(side) / _SAMPLE_M)) + 1 for side in (u, v))
        i, j = _inside(n, m)
        yield a[k] + i[:, None] * u + j[:, None] * v


def _inside(n: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    i, j = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, m), indexing="ij")
    inside = i + j <= 1.0
    return i[inside], j[inside]


def widened(cells: np.ndarray, by: int = 1) -> np.ndarray:
    """(R, C) bool: cells within so many cells of one of `cells`."""
    padded = np.pad(cells, by)
    return np.any([padded[i : i + cells.shape[0], j : j + cells.shape[1]]
                   for i in range(2 * by + 1) for j in range(2 * by + 1)], axis=0)  # fmt: skip


def seen_free(drive: Drive, xy: np.ndarray, range_m: float) -> np.ndarray:
    """(N,) bool: from some keyframe the straight line to 0.3 m over the place (N, 2), within the sensor's field of view
    and `range_m`, is free of geometry: there the sensor could see that nothing stands."""
    place, seen = drive.world.place, np.zeros(len(xy), bool)
    places = np.column_stack([xy, place.ground_m(xy[:, 0], xy[:, 1]) + LOW_M])
    for T in drive.poses:
        left = np.flatnonzero(~seen & (np.hypot(*(xy - T[:2, 3]).T) <= range_m))
        lines = places[left] - T[:3, 3]
        length = np.linalg.norm(lines, axis=1)
        up = np.arcsin(lines @ T[:3, 2] / length)
        hits = drive.world.cast(np.tile(T[:3, 3], (len(left), 1)), lines / length[:, None])
        seen[left] = (hits.range_m > length) & (up >= ELEVATIONS[0]) & (up <= ELEVATIONS[-1])
    return seen
