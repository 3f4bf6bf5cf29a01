"""The poses that were given out in the last seconds: what an answer that comes late is about."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray

from splitslam import se3

Array = NDArray[np.float64]


class PoseHistory:
    """T_odom_lidar by stamp, at IMU rate, for `kept_ns`."""

    def __init__(self, kept_ns: int) -> None:
        self._kept_ns = kept_ns
        self._stamps_ns: list[int] = []
        self._poses: list[Array] = []

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def append(self, stamps_ns: NDArray[np.int64], poses: Array) -> None:
        """stamps_ns: (M,), rising. poses: (M, 12) row-major 3x4."""
        self._stamps_ns += stamps_ns.tolist()
        self._poses += list(poses)
        too_old_ns = self._stamps_ns[-1] - self._kept_ns
        if self._stamps_ns[0] < too_old_ns - self._kept_ns // 4:  # seldom: it moves everything
            gone = bisect_left(self._stamps_ns, too_old_ns)
            del self._stamps_ns[:gone], self._poses[:gone]

    def at(self, stamp_ns: int) -> Array:
        """(4, 4) at `stamp_ns`, interpolated; the oldest or the newest one beyond them; identity without any."""
        if not self._poses:
            return np.eye(4)
        after = min(bisect_left(self._stamps_ns, stamp_ns), len(self._poses) - 1)
        T_after = _matrix(self._poses[after])
        if after == 0 or self._stamps_ns[after] <= stamp_ns:
            return T_after
        a, b = self._stamps_ns[after - 1], self._stamps_ns[after]
        return se3.interpolate(_matrix(self._poses[after - 1]), T_after, (stamp_ns - a) / (b - a))


def _matrix(pose: Array) -> Array:
    T = np.eye(4)
    T[:3] = pose.reshape(3, 4)
    return T
