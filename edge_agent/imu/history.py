"""The poses that were given out in the last seconds: what an answer that comes late is about."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import _kernels as kernels

Array = NDArray[np.float64]
_ROOM = 1024


class PoseHistory:
    """T_odom_lidar by stamp, at IMU rate, for `kept_ns`."""

    def __init__(self, kept_ns: int) -> None:
        self._kept_ns = kept_ns
        self._stamps_ns, self._poses = np.empty(_ROOM, np.int64), np.empty((_ROOM, 12))
        self._first = self._end = 0

    def __len__(self) -> int:
        return self._end - self._first

    def append(self, stamps_ns: NDArray[np.int64], poses: Array) -> None:
        """stamps_ns: (M,), rising. poses: (M, 12) row-major 3x4."""
        n = len(stamps_ns)
        if self._end + n > len(self._stamps_ns):
            self._make_room(n)
        rows = slice(self._end, self._end + n)
        self._stamps_ns[rows], self._poses[rows] = stamps_ns, poses
        self._end += n

    def _make_room(self, n: int) -> None:
        """Forgets what is too old, and takes more memory when that is not half of it."""
        stamps_ns, poses = self._stamps_ns, self._poses
        oldest_ns = int(stamps_ns[self._end - 1]) - self._kept_ns
        self._first += int(stamps_ns[self._first : self._end].searchsorted(oldest_ns))
        kept = len(self)
        if 2 * (kept + n) > len(stamps_ns):
            stamps_ns, poses = np.empty(4 * (kept + n), np.int64), np.empty((4 * (kept + n), 12))
        stamps_ns[:kept] = self._stamps_ns[self._first : self._end]
        poses[:kept] = self._poses[self._first : self._end]
        self._stamps_ns, self._poses, self._first, self._end = stamps_ns, poses, 0, kept

    def at(self, stamp_ns: int) -> Array:
        """(4, 4) at `stamp_ns`, interpolated; the oldest or the newest one beyond them; identity without any."""
        T = np.eye(4)
        if len(self):
            rows = slice(self._first, self._end)
            kernels.pose_at(self._stamps_ns[rows], self._poses[rows], stamp_ns, T)
        return T
