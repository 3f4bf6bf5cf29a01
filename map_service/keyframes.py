"""The keyframes of one session, in memory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from map_service.tracker import Track
from splitslam.features import FeatureFrame

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """One keyframe: T_local_lidar (4, 4) as the local map has it; points (N, 3) float32 and their intensity (N,)."""

    index: int
    seq: int
    stamp_ns: int
    T_local_lidar: Array
    corners_lidar: NDArray[np.float32]
    surfs_lidar: NDArray[np.float32]
    corners_intensity: NDArray[np.uint8]
    surfs_intensity: NDArray[np.uint8]

    @property
    def points_lidar(self) -> NDArray[np.float32]:
        """Both classes, (N, 3)."""
        return np.concatenate([self.corners_lidar, self.surfs_lidar])

    @property
    def count(self) -> int:
        """Points of both classes."""
        return len(self.corners_lidar) + len(self.surfs_lidar)


class Keyframes:
    """An append-only list of keyframes."""

    def __init__(self) -> None:
        self._items: list[Keyframe] = []
        self._way_m: list[float] = []

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, index: int) -> Keyframe:
        return self._items[index]

    def add(self, frame: FeatureFrame, track: Track) -> None:
        """Appends a tracked dense frame."""
        self.append(
            Keyframe(
                len(self._items),
                frame.seq,
                frame.stamp_ns,
                track.T_local_lidar,
                track.corners_lidar,
                track.surfs_lidar,
                frame.corners.intensity,
                frame.surfs.intensity,
            )
        )

    def append(self, keyframe: Keyframe) -> None:
        """Appends a restored keyframe."""
        step_m = np.linalg.norm(keyframe.T_local_lidar[:3, 3] - self._items[-1].T_local_lidar[:3, 3]) if self else 0.0
        self._way_m.append(float(step_m) + (self._way_m[-1] if self else 0.0))
        self._items.append(keyframe)

    def replace_first(self, corners_lidar: NDArray[np.float32], surfs_lidar: NDArray[np.float32]) -> None:
        """Keyframe 0 after it was deskewed again."""
        self._items[0] = replace(self._items[0], corners_lidar=corners_lidar, surfs_lidar=surfs_lidar)

    def T_local(self, index: int) -> Array:
        """Pose of a keyframe in `local`."""
        return self._items[index].T_local_lidar

    def move(self, poses: list[Array]) -> None:
        """New poses for all, after `local` has become `map`."""
        self._items = [replace(k, T_local_lidar=T) for k, T in zip(self._items, poses, strict=True)]

    def within(self, centre_m: Array, radius_m: float) -> list[int]:
        """Indices of the keyframes within the radius of a point (3,) in `local`."""
        positions = np.array([k.T_local_lidar[:3, 3] for k in self._items])
        return [int(i) for i in np.flatnonzero(np.linalg.norm(positions - centre_m, axis=1) < radius_m)]

    def way_m(self) -> Array:
        """(n,) length of the way from the first keyframe to each as it was driven, m."""
        return np.array(self._way_m)

    def stamps_ns(self) -> NDArray[np.int64]:
        """(n,) reference times."""
        return np.array([k.stamp_ns for k in self._items], np.int64)

    def submap(
        self, centre: int, first: int, last: int, poses: list[Array], at_most: int | None = None
    ) -> NDArray[np.float32]:
        """Points (N, 3) of keyframes first..last, inclusive and clipped, in the frame of keyframe `centre`.

        at_most: evenly thinned to about as many points, fewer than twice as many.
        """
        back = np.linalg.inv(poses[centre])
        chosen = range(max(first, 0), min(last, len(self) - 1) + 1)
        total = sum(self._items[i].count for i in chosen)
        every = 1 if at_most is None else max(1, total // at_most)
        parts = []
        for i in chosen:
            T = back @ poses[i]
            for points in (self._items[i].corners_lidar, self._items[i].surfs_lidar):
                parts.append((points[::every] @ T[:3, :3].T + T[:3, 3]).astype(np.float32))
        return np.concatenate(parts)
