"""Where in the local map a scan may have been taken, when its predicted place is in doubt.

Coarse: poses on a grid of positions and headings around the prediction, scored by how close a few hundred features lie
to the map. Fine: the best of them, no two at one place, are registered. What comes out is places with their scores;
what they mean is decided in doubt.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service import _search_kernels as kernels
from map_service.settings import WideSearchSettings
from splitslam import se3
from splitslam.features import FeatureFrame
from splitslam.registration.align import Prediction, Registration, RegistrationResult
from splitslam.registration.local_map import LocalMap
from splitslam.registration.settings import RegistrationSettings

Array = NDArray[np.float64]
_LEVER_M = RegistrationSettings().lever_m
_LEAST_SHARE = 0.02  # 0.05 and more wherever there is more than one wall, 0.004 and less where there is not


@dataclass(frozen=True, slots=True)
class Fit:
    """How well a scan fits. score: mean over its features of 1 - (r / 3)^2, r in sigmas, nothing beyond 3 (MSAC).

    tells: does the fit depend on the place? One wall lies as well on any other.
    """

    score: float
    features: int
    tells: bool = True

    @classmethod
    def of(cls, result: RegistrationResult) -> Fit:
        features = max(result.features, 1)
        score = result.inliers * (1.0 - result.error**2 / 9.0) / features
        return cls(score, features, _tells(result))

    @property
    def octave(self) -> int:
        """Scans with numbers of features alike, within a factor of two, have scores alike."""
        return round(float(np.log2(self.features)))


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A pose T_local_lidar (4, 4) that registration ends at, and how the scan fits there."""

    T_local_lidar: Array
    fit: Fit


class WideSearch:
    """One per session; holds the grid."""

    def __init__(self, settings: WideSearchSettings, registration: Registration) -> None:
        self.settings = settings
        self.registration = registration
        softer = registration.settings.model_copy(update={"point_sigma_m": settings.rough_sigma_m})
        self.rough_registration = Registration(softer)
        s, full = settings, round(2.0 * np.pi / settings.yaw_step_rad)
        self.offsets = _grid(s.radius_m, s.step_m, np.linspace(-np.pi, np.pi, full, endpoint=False))
        self.fine_offsets = _grid(0.75 * s.step_m, 0.25 * s.step_m, np.linspace(-0.5, 0.5, 5) * s.yaw_step_rad)

    def places(self, local_map: LocalMap, frame: FeatureFrame, T_local_lidar: Array) -> list[Place]:
        """The best places around T_local_lidar (4, 4), best first, each further than `apart_m` from all better ones."""
        s = self.settings
        poses = _moved_level(T_local_lidar, self.offsets)
        numbers = s.coarse_corners, s.coarse_surfs
        by_corners, by_surfs = self._closeness(local_map, frame, poses, numbers, s.coarse_gate_m)
        # corners tell places apart, surfs (mostly ground) where there are no corners: both have their say
        starts = self._apart(poses, by_corners, s.starts // 2, [])
        starts = self._apart(poses, by_corners + by_surfs, s.starts, starts)
        nearer = [self._sharpened(local_map, frame, poses[i]) for i in starts]
        rough = [self._registered(self.rough_registration, local_map, frame, T, s.rough_points) for T in nearer]
        rough.sort(key=lambda place: -place.fit.score)
        fine = []
        for place in rough[: s.finalists]:
            T = place.T_local_lidar
            for _ in range(s.softenings):  # each time from where it came to, with all freedom again
                T = self._registered(self.rough_registration, local_map, frame, T, s.fine_points).T_local_lidar
            fine.append(self.at(local_map, frame, T))
        fine.sort(key=lambda place: -place.fit.score)
        places: list[Place] = []
        for place in fine:
            if all(distance_m(place.T_local_lidar, p.T_local_lidar) > s.apart_m for p in places):
                places.append(place)
        return places

    def at(self, local_map: LocalMap, frame: FeatureFrame, T_local_lidar: Array) -> Place:
        """The place that registration ends at from T_local_lidar (4, 4), scored as `places` scores."""
        return self._registered(self.registration, local_map, frame, T_local_lidar, self.settings.fine_points)

    def _registered(
        self, registration: Registration, local_map: LocalMap, frame: FeatureFrame, T: Array, points: int
    ) -> Place:
        s = self.settings
        information = np.diag(1.0 / np.repeat([s.tilt_rad, s.tilt_rad, s.yaw_step_rad, s.step_m], [1, 1, 1, 3]) ** 2)
        prediction = Prediction(T, information, 1.0, 0.0, np.full(3, s.reach_m))
        corners = _thinned(frame.corners.points_lidar, points)
        surfs = _thinned(frame.surfs.points_lidar, points)
        offsets_s = np.zeros(len(corners)), np.zeros(len(surfs))  # not deskewed again: the motion is not in doubt
        result = registration.align(local_map, corners, surfs, offsets_s, prediction, False)
        return Place(result.T_local_lidar, Fit.of(result))

    def _sharpened(self, local_map: LocalMap, frame: FeatureFrame, T: Array) -> Array:
        """The best pose of a fine grid within half a step of T: registration alone does not reach so far in a wood."""
        s = self.settings
        poses = _moved_level(T, self.fine_offsets)
        numbers = s.rough_points, s.rough_points
        return poses[np.argmax(sum(self._closeness(local_map, frame, poses, numbers, s.fine_gate_m)))]

    def _closeness(
        self, local_map: LocalMap, frame: FeatureFrame, poses: Array, at_most: tuple[int, int], gate_m: float
    ) -> list[Array]:
        """Twice (C,): mean closeness of corners, and of surfs, to the map from each pose."""
        means = []
        for voxels, features, count in zip(
            (local_map.corners, local_map.surfs), (frame.corners, frame.surfs), at_most, strict=True
        ):
            points, scores, v = _thinned(features.points_lidar, count), np.zeros(len(poses)), voxels.settings
            kernels.closeness(voxels.slots, voxels.geometry, points, poses, v.voxel_m, v.levels, gate_m, scores)
            means.append(scores / max(len(points), 1))
        return means

    def _apart(self, poses: Array, scores: Array, count: int, chosen: list[int]) -> list[int]:
        """`chosen` filled up to `count` with the best poses, none at the place of another."""
        s, chosen = self.settings, list(chosen)
        for i in np.argsort(-scores, kind="stable"):
            if len(chosen) == count:
                break
            if all(
                distance_m(poses[i], poses[j]) > s.start_apart_m
                or se3.angle(poses[i][:3, :3].T @ poses[j][:3, :3]) > s.start_apart_rad
                for j in chosen
            ):
                chosen.append(int(i))
        return chosen


def _tells(result: RegistrationResult) -> bool:
    """Does the scan observe what places differ in, along the ground and about the vertical?

    The normals of one wall's fits waver by a degree or two, and so seem to say where along it a scan is: what counts is
    that direction's information against that of the clearest one.
    """
    H, up = result.information, result.T_local_lidar[2, :3]
    level = np.zeros((6, 3))  # of these directions, in metres at a lever
    level[:3, 0] = up / _LEVER_M
    level[3:, 1:] = result.T_local_lidar[:2, :3].T
    least, largest = np.linalg.eigvalsh(np.stack([level.T @ H @ level, H[3:, 3:]]))[[0, 1], [0, 2]]
    return bool(least > _LEAST_SHARE * largest)


def distance_m(T_a: Array, T_b: Array) -> float:
    """Between the origins of two poses (4, 4) in one frame."""
    return float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3]))


def _grid(radius_m: float, step_m: float, turns_rad: Array) -> Array:
    """(C, 3): x, y in m within the disc, heading in rad."""
    steps = np.arange(-np.floor(radius_m / step_m), radius_m / step_m + 1e-9) * step_m
    x, y, yaw = (a.reshape(-1) for a in np.meshgrid(steps, steps, turns_rad, indexing="ij"))
    return np.column_stack([x, y, yaw])[np.hypot(x, y) <= radius_m]


def _moved_level(T: Array, offsets: Array) -> Array:
    """(C, 4, 4): T moved in the horizontal plane of `local` and turned about the vertical."""
    poses = np.repeat(T[None], len(offsets), axis=0)
    c, s = np.cos(offsets[:, 2]), np.sin(offsets[:, 2])
    poses[:, 0, :3] = c[:, None] * T[0, :3] - s[:, None] * T[1, :3]
    poses[:, 1, :3] = s[:, None] * T[0, :3] + c[:, None] * T[1, :3]
    poses[:, :2, 3] += offsets[:, :2]
    return poses


def _thinned(points: NDArray[np.float32], at_most: int) -> NDArray[np.float32]:
    """Every n-th point, at most so many."""
    return np.ascontiguousarray(points[:: max(1, -(-len(points) // at_most))])
