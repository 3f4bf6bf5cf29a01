"""The newest dense scans with their poses: what the edge's odometry matches against when it has to begin."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.features import FeatureFrame, FeatureSet

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A dense scan at its pose. index: counts up, never used again.

    T_steady_lidar: (4, 4); `steady` is the frame of the poses that the Imu node is given (outage.py). covariance:
    (6, 6), right tangent, of the pose in `map`.
    """

    index: int
    stamp_ns: int
    T_steady_lidar: Array
    covariance: Array
    corners_lidar: NDArray[np.float32]
    surfs_lidar: NDArray[np.float32]


def even_shares(sets: Sequence[FeatureSet], points: int) -> list[NDArray[np.int64]]:
    """Rows of each set that are an even share of it, at most `points` of all together."""
    share = min(1.0, points / max(sum(map(len, sets)), 1))
    return [np.linspace(0, len(s), int(share * len(s)), endpoint=False).astype(np.int64) for s in sets]


class Ring:
    """At most `limit` keyframes of at most `points` features; the oldest goes first. Adding one costs little."""

    def __init__(self, limit: int, apart_ns: int, points: int) -> None:
        self.keyframes: deque[Keyframe] = deque()
        self._limit, self._apart_ns, self._points = limit, apart_ns, points
        self._count = 0

    def wants(self, frame: FeatureFrame) -> bool:
        """A dense scan, not too soon after the last one."""
        newest_ns = self.keyframes[-1].stamp_ns if self.keyframes else None
        return frame.dense and (newest_ns is None or frame.stamp_ns - newest_ns >= self._apart_ns)

    def add(self, frame: FeatureFrame, T_steady_lidar: Array, covariance: Array) -> tuple[Keyframe, Keyframe | None]:
        """The new keyframe, at T_steady_lidar (4, 4) with covariance (6, 6), and the one that had to go for it."""
        sets = frame.corners, frame.surfs
        points = (s.points_lidar[rows] for s, rows in zip(sets, even_shares(sets, self._points), strict=True))
        made = Keyframe(self._count, frame.stamp_ns, T_steady_lidar, covariance, *points)
        self._count += 1
        self.keyframes.append(made)
        return made, self.keyframes.popleft() if len(self.keyframes) > self._limit else None

    def clear(self) -> None:
        """Forgets them all."""
        self.keyframes.clear()

    def seen_by(self, indices: NDArray[np.int64]) -> list[tuple[Array, Array]]:
        """Pose (4, 4) and covariance (6, 6) of each of these keyframes; of the oldest for what went before it."""
        first = self.keyframes[0].index
        kept = [self.keyframes[max(i - first, 0)] for i in indices.tolist()] or [self.keyframes[-1]]
        return [(k.T_steady_lidar, k.covariance) for k in kept]
