"""The keyframes of one session: where they are in memory, what they saw there or still in the store."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service.cloud import decode_cloud
from map_service.growing import Growing
from map_service.tracker import Track
from splitslam.features import FeatureFrame

Array = NDArray[np.float64]
Fetch = Callable[[Sequence[int]], dict[int, bytes]]  # keyframes -> their clouds as map_service.cloud encodes them


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """What a keyframe saw: points (N, 3) float32, m, frame `lidar`, and their intensity (N,) uint8, by class."""

    corners_lidar: NDArray[np.float32]
    surfs_lidar: NDArray[np.float32]
    corners_intensity: NDArray[np.uint8]
    surfs_intensity: NDArray[np.uint8]

    @property
    def count(self) -> int:
        """Points of both classes."""
        return len(self.corners_lidar) + len(self.surfs_lidar)

    @classmethod
    def decoded(cls, data: bytes) -> Cloud:
        """From map_service.cloud's encoding. Raises DataError."""
        points, intensity, is_corner = decode_cloud(data)
        return cls(points[is_corner], points[~is_corner], intensity[is_corner], intensity[~is_corner])


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """One keyframe: T_local_lidar (4, 4) as the local map has it, and its cloud."""

    index: int
    seq: int
    stamp_ns: int
    T_local_lidar: Array
    cloud: Cloud


class Keyframes:
    """An append-only list. After a restart a cloud is fetched when it is first needed: most never are."""

    def __init__(self, fetch: Fetch | None = None) -> None:
        """fetch: for keyframes that were appended without their cloud."""
        self._fetch = fetch
        self._seqs: list[int] = []
        self._stamps_ns = Growing(dtype=np.int64)
        self._T_local = Growing((4, 4))
        self._clouds: list[Cloud | None] = []
        self._way_m = Growing()

    def __len__(self) -> int:
        return len(self._T_local)

    def __getitem__(self, index: int) -> Keyframe:
        return Keyframe(
            index,
            self._seqs[index],
            int(self._stamps_ns.values[index]),
            self.T_local(index),
            self._with_clouds([index])[0],
        )

    @property
    def loaded(self) -> int:
        """Clouds in memory."""
        return sum(cloud is not None for cloud in self._clouds)

    def add(self, frame: FeatureFrame, track: Track) -> None:
        """Appends a tracked dense frame."""
        cloud = Cloud(track.corners_lidar, track.surfs_lidar, frame.corners.intensity, frame.surfs.intensity)
        self.append(frame.seq, frame.stamp_ns, track.T_local_lidar, cloud)

    def append(self, seq: int, stamp_ns: int, T_local_lidar: Array, cloud: Cloud | None) -> None:
        """Appends one; cloud None: it is in the store."""
        way_m = 0.0
        if self:
            way_m = self._way_m.values[-1] + np.linalg.norm(T_local_lidar[:3, 3] - self.T_local(-1)[:3, 3])
        self._way_m.append(way_m)
        self._seqs.append(seq)
        self._stamps_ns.append(stamp_ns)
        self._T_local.append(T_local_lidar)
        self._clouds.append(cloud)

    def replace_first(self, corners_lidar: NDArray[np.float32], surfs_lidar: NDArray[np.float32]) -> None:
        """Keyframe 0 after it was deskewed again."""
        (cloud,) = self._with_clouds([0])
        self._clouds[0] = Cloud(corners_lidar, surfs_lidar, cloud.corners_intensity, cloud.surfs_intensity)

    def T_local(self, index: int | NDArray[np.int64]) -> Array:
        """Pose of a keyframe in `local`, or of several (n, 4, 4)."""
        return self._T_local.values[index]

    def move(self, poses: Array) -> None:
        """New poses (n, 4, 4) for all, after `local` has become `map`."""
        self._T_local.replace(poses)

    def within(self, centre_m: Array, radius_m: float) -> list[Keyframe]:
        """The keyframes within the radius of a point (3,) in `local`."""
        off_m = np.linalg.norm(self._T_local.values[:, :3, 3] - centre_m, axis=1)
        near = np.flatnonzero(off_m < radius_m).tolist()
        self._with_clouds(near)
        return [self[i] for i in near]

    def way_m(self) -> Array:
        """(n,) length of the way from the first keyframe to each as it was driven, m."""
        return self._way_m.values

    def stamps_ns(self) -> NDArray[np.int64]:
        """(n,) reference times."""
        return self._stamps_ns.values

    def submap(
        self, centre: int, first: int, last: int, poses: Array, at_most: int | None = None
    ) -> NDArray[np.float32]:
        """Points (N, 3) of keyframes first..last, inclusive and clipped, in the frame of keyframe `centre`.

        at_most: evenly thinned to about as many points, fewer than twice as many.
        """
        back = np.linalg.inv(poses[centre])
        chosen = range(max(first, 0), min(last, len(self) - 1) + 1)
        clouds = self._with_clouds(chosen)
        every = 1 if at_most is None else max(1, sum(cloud.count for cloud in clouds) // at_most)
        parts = []
        for i, cloud in zip(chosen, clouds, strict=True):
            T = back @ poses[i]
            for points in (cloud.corners_lidar, cloud.surfs_lidar):
                parts.append((points[::every] @ T[:3, :3].T + T[:3, 3]).astype(np.float32))
        return np.concatenate(parts)

    def _with_clouds(self, indices: Iterable[int]) -> list[Cloud]:
        """Their clouds; those that are not in memory come with one query."""
        wanted = list(indices)
        missing = [i for i in wanted if self._clouds[i] is None]
        if missing:
            assert self._fetch is not None
            for i, data in self._fetch(missing).items():
                self._clouds[i] = Cloud.decoded(data)
        clouds = [self._clouds[i] for i in wanted]
        return [cloud for cloud in clouds if cloud is not None]
