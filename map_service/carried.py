"""Scans whose pose was carried, not believed: they get the pose that was theirs, once the robot is found.

From the scan that was found back to where the robot was lost, each is registered from the one after it; where that does
not succeed, or the points are no longer at hand, the edge's own motion counts from there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.features import FeatureFrame

Array = NDArray[np.float64]
WITH_POINTS = 50  # 5 s: their points are kept, 60 kB a scan
MOST = 600  # a minute: older ones stay as they were carried


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """A scan and the pose T_local_lidar (4, 4) that it was given. frame: None after a restart and for older ones."""

    seq: int
    stamp_ns: int
    T_local_lidar: Array
    frame: FeatureFrame | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Later:
    """The scan after one that is placed: its pose T_local_lidar (4, 4), and twist (6,) rad/s, m/s on the way to it."""

    frame: FeatureFrame | None
    stamp_ns: int
    T_local_lidar: Array
    twist: Array


# Pose T_local_lidar (4, 4) of a frame by the map and the scan after it, or None when it does not fit there.
Placing = Callable[[FeatureFrame, Later], Array | None]


class CarriedScans:
    """Those since the last pose that was believed, oldest first."""

    def __init__(self) -> None:
        self._scans: deque[Carried] = deque(maxlen=MOST)

    def __len__(self) -> int:
        return len(self._scans)

    def add(self, frame: FeatureFrame, T_local_lidar: Array) -> None:
        """The next one, where it was carried to (4, 4)."""
        if len(self._scans) >= WITH_POINTS:
            self._scans[-WITH_POINTS] = replace(self._scans[-WITH_POINTS], frame=None)
        self._scans.append(Carried(frame.seq, frame.stamp_ns, T_local_lidar, frame))

    def clear(self) -> None:
        self._scans.clear()

    def placed(self, found: Later, T_carried: Array, place: Placing) -> Iterator[Carried]:
        """Each at its place, newest first. T_carried (4, 4): where the scan that was found had been carried to."""
        later = found
        for scan in reversed(self._scans):
            T = None if scan.frame is None or later.frame is None else place(scan.frame, later)
            if T is None:
                T = later.T_local_lidar @ se3.inv(T_carried) @ scan.T_local_lidar
            interval_s = max((later.stamp_ns - scan.stamp_ns) * 1e-9, 1e-3)
            twist = se3.log(se3.inv(T) @ later.T_local_lidar) / interval_s
            later, T_carried = Later(scan.frame, scan.stamp_ns, T, twist), scan.T_local_lidar
            yield replace(scan, T_local_lidar=se3.orthonormalised(T))

    def move(self, T_new_local: Array) -> None:
        """`local` is renamed, by T_new_local (4, 4)."""
        for i, scan in enumerate(self._scans):
            self._scans[i] = replace(scan, T_local_lidar=se3.orthonormalised(T_new_local @ scan.T_local_lidar))

    def dump(self) -> list:
        """JSON-ready; without the points."""
        return [
            [
                s.seq,
                s.stamp_ns,
                *s.T_local_lidar[:3, 3].tolist(),
                *se3.quat_from_matrix(s.T_local_lidar[:3, :3]).tolist(),
            ]
            for s in self._scans
        ]

    def load(self, data: list) -> None:
        """What `dump` gave."""
        self.clear()
        for seq, stamp_ns, *pose in data:
            values = np.array(pose)
            self._scans.append(Carried(seq, stamp_ns, se3.from_quat(values[:3], values[3:])))
