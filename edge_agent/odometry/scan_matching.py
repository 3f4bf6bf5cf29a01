"""Scan matching against the ring: the map service's registration, on the robot, with a map of the last seconds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from edge_agent.odometry.ring import Keyframe, Ring, even_shares
from edge_agent.odometry.settings import OdometrySettings
from splitslam import se3
from splitslam.features import FeatureFrame, FeatureSet
from splitslam.registration.align import Prediction, Registration, RegistrationResult
from splitslam.registration.doubt import Slip, carried_over
from splitslam.registration.local_map import LocalMap

Array = NDArray[np.float64]
_ROOM = 1 << 18  # in an outage 60 MB with the corners': twice as many voxels as 80 keyframes of a street make


class Outcome(StrEnum):
    """How a scan was placed. DEGENERATE: but for some directions. FAILED: nothing to hold on to, the Imu node's
    motion carries the pose."""

    PLACED = "placed"
    DEGENERATE = "degenerate"
    FAILED = "failed"


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where a scan is: T_steady_lidar (4, 4), its covariance (6, 6) in `map`, right tangent, and the directions (A, 6)
    that the features did not observe."""

    seq: int
    stamp_ns: int
    T_steady_lidar: Array
    covariance: Array
    degenerate_axes: Array
    outcome: Outcome


class ScanMatching:
    """Places one scan after the other, from `start` on. Holds a map of the ring's keyframes, and forgets with it."""

    def __init__(self, settings: OdometrySettings, ring: Ring, redeskew: bool, room: int = _ROOM) -> None:
        """redeskew: points may be moved again where the scan's motion turns out to be another (not with `off`).

        room: voxels of the surfs' map that memory is taken for; a power of two.
        """
        self._settings, self._ring, self._redeskew = settings, ring, redeskew
        self._registration = Registration(settings.registration)
        self._capacity = max(room // 8, 1), room
        self._local_map = self._empty_map()
        self._slip = Slip()
        self._last: Placement | None = None
        self._older: list[Keyframe] = []  # not in the map yet, the newest last
        self._failed = 0  # scans in a row

    def _empty_map(self) -> LocalMap:
        """Its memory stays with the system until an outage writes to it, page by page."""
        return LocalMap(self._settings.local_map, self._capacity)

    def start(self, last: Placement) -> None:
        """Begins with a map of the newest keyframes, so that no scan costs much more than another. The next scan
        follows `last`."""
        self._last, self._slip, self._failed = last, Slip(), 0
        self._older = list(self._ring.keyframes)
        self._take_older(self._settings.first_keyframes)

    def stop(self) -> None:
        """Lets go of the map."""
        self._local_map = self._empty_map()
        self._last, self._older = None, []

    def place(self, frame: FeatureFrame) -> Placement:
        """The scan after the last one."""
        last, motion = self._last, frame.motion
        assert last is not None
        self._take_older(self._settings.more_keyframes)
        result = self._align(frame, last)
        outcome, T, axes = self._judge(result), result.T_local_lidar, result.degenerate_axes
        if outcome == Outcome.FAILED:
            T, axes = last.T_steady_lidar @ motion.T_prev_lidar, np.eye(6)
        self._slip.follow(se3.inv(last.T_steady_lidar) @ T, axes, motion.covariance)
        of_map = carried_over(T, self._ring.seen_by(result.keyframes)) + self._slip.covariance
        covariance = of_map if outcome == Outcome.FAILED else of_map + self._settings.doubt * result.covariance
        self._last = Placement(frame.seq, frame.stamp_ns, T, covariance, axes, outcome)
        self._failed = self._failed + 1 if outcome == Outcome.FAILED else 0
        if self._ring.wants(frame) and (outcome != Outcome.FAILED or self._begins_anew(result)):
            self._add(frame, self._last)
        return self._last

    def _begins_anew(self, result: RegistrationResult) -> bool:
        """What is around has nothing in common with the map, as after a LiDAR that was covered: the scan is where it
        was carried to, and the next ones have it to hold on to."""
        s = self._settings
        return self._failed >= s.failed_scans and result.features >= s.min_features

    def _align(self, frame: FeatureFrame, last: Placement) -> RegistrationResult:
        """As in map_service/scan_alignment.py: the Imu node's motion is the start, and a measurement."""
        motion, s = frame.motion, self._settings
        interval_s = max((frame.stamp_ns - last.stamp_ns) * 1e-9, 1e-3)
        sigmas = np.sqrt(np.maximum(np.diag(motion.covariance), 1e-12))
        floors = np.repeat([s.pose_rotation_rad, s.pose_translation_m], 3)
        rates = sigmas / interval_s
        prediction = Prediction(
            last.T_steady_lidar @ motion.T_prev_lidar,
            np.diag(1.0 / (sigmas**2 + floors**2)),
            interval_s,
            float(rates[:3].max()),
            rates[3:],
        )
        sets = frame.corners, frame.surfs
        corners, surfs = (_points(*of) for of in zip(sets, even_shares(sets, s.points), strict=True))
        return self._registration.align(
            self._local_map, corners[0], surfs[0], (corners[1], surfs[1]), prediction, self._redeskew
        )

    def _judge(self, result: RegistrationResult) -> Outcome:
        s = self._settings
        if result.inliers < s.min_inliers or result.inliers < s.min_inlier_share * result.features:
            return Outcome.FAILED
        return Outcome.DEGENERATE if len(result.degenerate_axes) else Outcome.PLACED

    def _add(self, frame: FeatureFrame, placement: Placement) -> None:
        keyframe, gone = self._ring.add(frame, placement.T_steady_lidar, placement.covariance)
        self._insert(keyframe)
        if gone is not None and self._older and self._older[0] is gone:
            del self._older[0]
        elif gone is not None:
            self._local_map.remove(gone.index, gone.T_steady_lidar, gone.corners_lidar, gone.surfs_lidar)

    def _take_older(self, count: int) -> None:
        while self._older and count:
            self._insert(self._older.pop())
            count -= 1

    def _insert(self, keyframe: Keyframe) -> None:
        self._local_map.insert(keyframe.index, keyframe.T_steady_lidar, keyframe.corners_lidar, keyframe.surfs_lidar)


def _points(features: FeatureSet, rows: NDArray[np.int64]) -> tuple[NDArray[np.float32], Array]:
    """Points (N, 3), and their times (N,) after the scan's reference time, s."""
    return features.points_lidar[rows], np.multiply(features.t_offset_ns[rows], 1e-9, dtype=np.float64)
