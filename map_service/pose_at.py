"""Where the robot was at a moment, by the map of now or as it was in an earlier version of it.

delta = T_map_lidar(now) @ inv(T_map_lidar(then)) takes what was anchored in the map of then to where it belongs now.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, func, select

from map_service import schema
from map_service.history import unpack_poses
from map_service.packing import unpack_pose
from map_service.scan_poses import Versions, versions
from map_service.scans import StoredScan
from map_service.session_scans import SessionScans
from map_service.types import State
from splitslam import se3
from splitslam.errors import DataError

GAP_NS = 1_000_000_000  # between scans further apart nobody knows where the robot was
_WORST_FIRST = (
    *(State.LOST, State.LOCALISING, State.INITIALISING, State.UNANCHORED, State.DEGENERATE, State.TRACKING),
)

Array = NDArray[np.float64]


class NotKnownError(Exception):
    """There is no pose at that time, or no such version any more."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseAt:
    """T_map_lidar (4, 4) at a moment between scans seq_before and seq_after; covariance (6, 6) as they were answered.

    map_version: the one it is in; it can be asked for in oldest_version to newest_version. thinned: a scan it lies
    between has no pose of its own any more.
    """

    T_map_lidar: Array
    covariance: Array | None
    state: State
    map_version: int
    newest_version: int
    oldest_version: int
    seq_before: int
    seq_after: int
    thinned: bool


class SessionPoses:
    """One session in one state of its store."""

    def __init__(self, connection: Connection, key: int) -> None:
        self._connection, self._key = connection, key
        self._scans = SessionScans(connection, key)
        s, v = schema.sessions, schema.map_versions
        newest = connection.execute(select(s.c.map_version).where(s.c.id == key)).scalar()
        kept = select(func.min(v.c.version)).where(v.c.session == key, v.c.poses.is_not(None))
        self.newest_version = newest or 1
        self.oldest_version = (connection.execute(kept).scalar() or self.newest_version + 1) - 1

    def at(self, stamp_ns: int, map_version: int = 0) -> PoseAt:
        """map_version 0: of now. Raises NotKnownError, DataError."""
        before, after = self._around(stamp_ns)
        wanted = map_version or self.newest_version
        if wanted == self.newest_version:
            T_before, T_after = self._now(before), self._now(after)
        else:
            T_before = self._then(before, wanted)
            T_after = T_before @ se3.inv(self._now(before)) @ self._now(after)
            if after.seq < self._versions.first_seq(wanted + 1):
                T_after = self._then(after, wanted)
        span_ns = after.stamp_ns - before.stamp_ns
        ratio = (stamp_ns - before.stamp_ns) / span_ns if span_ns else 0.0
        return PoseAt(
            se3.interpolate(T_before, T_after, ratio),
            _between(before.covariance, after.covariance, ratio),
            min((State(before.state), State(after.state)), key=_WORST_FIRST.index),
            wanted,
            self.newest_version,
            self.oldest_version,
            before.seq,
            after.seq,
            before.thinned or after.thinned,
        )

    def _around(self, stamp_ns: int) -> tuple[StoredScan, StoredScan]:
        """The scans before and after a moment; twice the same when it is a scan's."""
        before, after = self._scans.before(stamp_ns), self._scans.since(stamp_ns)
        if before is None or after is None:
            ends = f"begins at {after.stamp_ns}" if after else f"ends at {before.stamp_ns}" if before else "has no scan"
            raise NotKnownError(f"stamp_ns {stamp_ns}: the session {ends}")
        if after.stamp_ns - before.stamp_ns > GAP_NS:
            raise NotKnownError(f"stamp_ns {stamp_ns}: no scan between {before.stamp_ns} and {after.stamp_ns}")
        return before, after

    def _now(self, frame: StoredScan) -> Array:
        k = schema.keyframes
        query = select(k.c.pose_map_lidar).where(k.c.session == self._key, k.c.keyframe == frame.keyframe)
        return unpack_pose(self._connection.execute(query).scalar()) @ frame.T_keyframe_lidar

    def _then(self, frame: StoredScan, version: int) -> Array:
        """As answered, for a frame of that very version; by its keyframe as the version ended, for an earlier one."""
        poses = self._poses_of(version)
        if frame.seq >= self._versions.first_seq(version + 1):
            first = self._versions.of(frame.seq)
            raise NotKnownError(f"map_version {version}: scan {frame.seq} is first known in version {first}")
        if self._versions.of(frame.seq) == version:
            return frame.T_map_lidar
        if frame.keyframe >= len(poses):
            raise DataError("corrupt", f"frame {frame.seq} is on a keyframe that version {version} has not")
        return poses[frame.keyframe] @ frame.T_keyframe_lidar

    def _poses_of(self, version: int) -> Array:
        """(n, 4, 4) T_map_lidar of the keyframes as a version ended."""
        known = self.oldest_version <= version <= self.newest_version
        v = schema.map_versions
        query = select(v.c.poses).where(v.c.session == self._key, v.c.version == version + 1)
        poses = self._connection.execute(query).scalar() if known else None
        if poses is None:
            raise NotKnownError(f"map_version {version}: known are {self.oldest_version} to {self.newest_version}")
        return unpack_poses(poses)

    @property
    def _versions(self) -> Versions:
        return versions(self._connection, self._key)


def _between(before: Array | None, after: Array | None, ratio: float) -> Array | None:
    if before is None or after is None:
        return after if before is None else before
    return (1.0 - ratio) * before + ratio * after
