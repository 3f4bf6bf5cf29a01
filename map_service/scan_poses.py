"""Scans as splitslam.v1.ScanPose: from an answer that has just been given, or from the rows that hold it."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, select

from map_service import schema
from map_service.messages import transform_from_wire, transform_to_wire
from map_service.pose_track import TrackedScan
from map_service.session_scans import SessionScans
from splitslam import se3
from splitslam.errors import DataError, InputError
from splitslam.robot import robot_from_yaml
from splitslam.wire import pose_pb2 as pb
from splitslam.wire import session_pb2 as session_pb

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Versions:
    """Which frames were answered in which version of a session's map. began: (version, first_seq), ascending."""

    began: tuple[tuple[int, int], ...]

    def first_seq(self, version: int) -> int:
        """The first frame that was answered in it. Raises KeyError when that is not known."""
        return dict(self.began)[version]

    def of(self, seq: int) -> int:
        """The version that frame `seq` was answered in."""
        at = bisect_right(self.began, seq, key=lambda row: row[1])
        if at:
            return self.began[at - 1][0]
        return self.began[0][0] - 1 if self.began else 1


def versions(connection: Connection, key: int) -> Versions:
    """Of a session; of those that are no longer known, frames count to the last of them."""
    t = schema.map_versions
    query = select(t.c.version, t.c.first_seq).where(t.c.session == key).order_by(t.c.version)
    return Versions(tuple((row.version, row.first_seq) for row in connection.execute(query)))


def lidar_body(robot_file: str) -> Array:
    """T_lidar_body (4, 4) by the robot file that a session was opened with. Raises DataError."""
    try:
        return se3.inv(np.array(robot_from_yaml(robot_file, "the stored robot file").T_body_lidar))
    except InputError as error:
        raise DataError("corrupt", str(error)) from None


def read_lidar_body(connection: Connection, key: int) -> Array:
    """As `lidar_body`, of a stored session. Raises DataError."""
    t = schema.sessions
    return lidar_body(connection.execute(select(t.c.robot_file).where(t.c.id == key)).scalar_one())


def live_scan(session_id: str, body: bytes, T_lidar_body: Array) -> TrackedScan | None:
    """Of a serialised StreamResponse with an answer; None: it was answered before."""
    answer = session_pb.StreamResponse.FromString(body).odometry
    if answer.duplicate:
        return None
    if answer.rejected:
        return TrackedScan(answer.seq, None)
    return TrackedScan(
        answer.seq,
        pb.ScanPose(
            session_id=session_id,
            seq=answer.seq,
            stamp_ns=answer.stamp_ns,
            pose_map_lidar=answer.pose_map_lidar,
            pose_map_body=transform_to_wire(transform_from_wire(answer.pose_map_lidar) @ T_lidar_body),
            covariance=answer.covariance,
            state=answer.state,
            map_version=answer.map_version,
            keyframe=answer.keyframe,
        ),
    )


def stored_scans(
    connection: Connection, key: int, session_id: str, after_seq: int, limit: int, T_lidar_body: Array
) -> list[TrackedScan]:
    """The next frames after `after_seq` as they were answered, at most `limit`. Raises DataError."""
    found = SessionScans(connection, key).after(after_seq, limit)
    if not found:
        return []
    k, known = schema.keyframes, versions(connection, key)
    among = select(k.c.seq).where(k.c.session == key, k.c.seq.between(found[0].seq, found[-1].seq))
    keyframes = set(connection.execute(among).scalars())
    scans: list[TrackedScan] = []
    for scan in found:
        if scan.rejected:
            scans.append(TrackedScan(scan.seq, None))
            continue
        pose = pb.ScanPose(
            session_id=session_id,
            seq=scan.seq,
            stamp_ns=scan.stamp_ns,
            pose_map_lidar=transform_to_wire(scan.T_map_lidar),
            pose_map_body=transform_to_wire(scan.T_map_lidar @ T_lidar_body),
            covariance=() if scan.covariance is None else scan.covariance.ravel().tolist(),
            state=scan.state,  # type: ignore[arg-type]
            map_version=known.of(scan.seq),
            keyframe=scan.seq in keyframes,
            thinned=scan.thinned,
        )
        scans.append(TrackedScan(scan.seq, pose))
    return scans
