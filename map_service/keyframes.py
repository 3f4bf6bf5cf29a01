"""The keyframes of one session: when and where they were taken, and what they saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service.clouds import Cloud, Clouds, Fetch
from map_service.growing import GrowingArray, Poses
from map_service.tracker import Track
from splitslam.features import FeatureFrame

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """One keyframe: T_local_lidar (4, 4) as the local map has it, and its cloud."""

    index: int
    seq: int
    stamp_ns: int
    T_local_lidar: Array
    cloud: Cloud


class Keyframes:
    """An append-only list.

    A keyframe follows on the one before, or, where the robot left ground that was mapped already, on another: there a
    new stretch begins. Neighbours in number are neighbours in the world only within a stretch.
    """

    def __init__(self, fetch: Fetch | None = None) -> None:
        """fetch: for keyframes that were appended without their cloud."""
        self.clouds = Clouds(fetch)
        self._seqs, self._stamps_ns = GrowingArray(dtype=np.int64), GrowingArray(dtype=np.int64)
        self._poses = Poses()
        self._way_m, self._stretch = GrowingArray(), GrowingArray(dtype=np.int64)
        self.branches: list[tuple[int, int, float]] = []  # (keyframe, the one it follows, m between them)

    def __len__(self) -> int:
        return len(self._poses)

    def __getitem__(self, index: int) -> Keyframe:
        (cloud,) = self.clouds.get([index])
        return Keyframe(index, int(self._seqs.rows[index]), int(self._stamps_ns.rows[index]), self._poses[index], cloud)

    def add(self, frame: FeatureFrame, track: Track, follows: int) -> None:
        """Appends a tracked dense frame; follows: the keyframe that its odometry starts from."""
        cloud = Cloud(track.corners_lidar, track.surfs_lidar, frame.corners.intensity, frame.surfs.intensity)
        self.append(frame.seq, frame.stamp_ns, track.T_local_lidar, cloud, follows)

    def append(
        self, seq: int, stamp_ns: int, T_local_lidar: Array, cloud: Cloud | None, follows: int | None = None
    ) -> None:
        """Appends one at T_local_lidar (4, 4); cloud None: it is in the store. follows None: the newest."""
        newest = len(self) - 1
        follows = newest if follows is None or not self else follows
        step_m = float(np.linalg.norm(T_local_lidar[:3, 3] - self._poses[follows][:3, 3])) if self else 0.0
        if follows != newest:
            self.branches.append((newest + 1, follows, step_m))
        self._way_m.append(step_m + (self._way_m.rows[-1] if self else 0.0))
        self._stretch.append(len(self.branches))
        self._seqs.append(seq)
        self._stamps_ns.append(stamp_ns)
        self._poses.append(T_local_lidar)
        self.clouds.append(cloud)

    def replace_first(self, corners_lidar: NDArray[np.float32], surfs_lidar: NDArray[np.float32]) -> None:
        """Keyframe 0 after it was deskewed again; features (N, 3)."""
        (cloud,) = self.clouds.get([0])
        self.clouds.replace(0, Cloud(corners_lidar, surfs_lidar, cloud.corners_intensity, cloud.surfs_intensity))

    def T_local(self, index: int) -> Array:
        """Pose (4, 4) of a keyframe in `local`."""
        return self._poses[index]

    def poses_local(self) -> Array:
        """(n, 4, 4) of all."""
        return self._poses.matrices

    def move(self, poses: Sequence[Array]) -> None:
        """New poses (4, 4) for all, after `local` has become `map`."""
        assert len(poses) == len(self)
        self._poses.matrices[:] = np.asarray(poses)

    def place(self, poses: Array, fixed: set[int]) -> None:
        """New poses (n, 4, 4) for those that are not `fixed`: the local map has these where they were."""
        kept = sorted(fixed)
        then = self._poses.matrices[kept]
        self._poses.matrices[:] = poses
        self._poses.matrices[kept] = then

    def within(self, centre_m: Array, radius_m: float) -> list[int]:
        """The keyframes within the radius of a point (3,) in `local`."""
        away_m = np.linalg.norm(self._poses.positions_m - centre_m, axis=1)
        return np.flatnonzero(away_m < radius_m).tolist()

    def up_to_seq(self, seq: int) -> int:
        """How many keyframes are of frames up to `seq`."""
        return int(np.searchsorted(self._seqs.rows, seq, side="right"))

    def way_m(self) -> Array:
        """(n,) length of the way from the first keyframe to each over new ground, m."""
        return self._way_m.rows

    def stamps_ns(self) -> NDArray[np.int64]:
        """(n,) reference times."""
        return self._stamps_ns.rows

    def around(self, centre: int, before: int, after: int) -> range:
        """Keyframes from `before` before to `after` after one, of its own stretch."""
        stretch = self._stretch.rows
        first, last = (
            np.searchsorted(stretch, stretch[centre], "left"),
            np.searchsorted(stretch, stretch[centre], "right"),
        )
        return range(max(centre - before, int(first)), min(centre + after, int(last) - 1) + 1)

    def submap(
        self, centre: int, before: int, after: int, poses: Sequence[Array], at_most: int | None = None
    ) -> NDArray[np.float32]:
        """Points (N, 3) of the keyframes around one, see `around`, in its frame. Raises CloudsAwayError.

        at_most: evenly thinned to about as many points, fewer than twice as many.
        """
        back = np.linalg.inv(poses[centre])
        chosen = self.around(centre, before, after)
        clouds = self.clouds.get(chosen)
        every = 1 if at_most is None else max(1, sum(cloud.count for cloud in clouds) // at_most)
        parts = []
        for i, cloud in zip(chosen, clouds, strict=True):
            T = back @ poses[i]
            for points in (cloud.corners_lidar, cloud.surfs_lidar):
                parts.append((points[::every] @ T[:3, :3].T + T[:3, 3]).astype(np.float32))
        return np.concatenate(parts)
