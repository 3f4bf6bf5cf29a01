"""A commit as rows of the store's tables."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from sqlalchemy import BigInteger, Connection, Delete, Table, bindparam, delete, insert, update

from map_service import schema
from map_service.history import history_bytes
from map_service.packing import COVARIANCE_BYTES, POSE_BYTES, pack_all, pack_covariances, pack_pose
from map_service.types import Commit

FRAME_ROW_BYTES = 3 * POSE_BYTES + COVARIANCE_BYTES + 40


def _delete(table: Table) -> Delete:
    """Of a session `key`, the keyframes `indices`."""
    return delete(table).where(
        table.c.session == bindparam("key"), table.c.keyframe.in_(bindparam("indices", expanding=True))
    )


# Statements are made once: to make one costs more than to run it.
_INSERTS = [
    insert(table)
    for table in (schema.frames, schema.keyframes, schema.clouds, schema.factors, schema.places, schema.holes)
]
_DELETE_CLOUDS, _DELETE_KEYFRAMES, _DELETE_PLACES = map(_delete, (schema.clouds, schema.keyframes, schema.places))
_COUNT_KEYFRAMES = (
    update(schema.sessions)
    .where(schema.sessions.c.id == bindparam("key"))
    .values(keyframes=schema.sessions.c.keyframes + bindparam("new", type_=BigInteger))
)
_PLACE_FRAME = (
    update(schema.frames)
    .where(
        schema.frames.c.session == bindparam("key"),
        schema.frames.c.seq == bindparam("number"),
        schema.frames.c.rejected == "",
    )
    .values(pose_keyframe_lidar=bindparam("pose"))
)
_MOVE_KEYFRAME = (
    update(schema.keyframes)
    .where(schema.keyframes.c.session == bindparam("key"), schema.keyframes.c.keyframe == bindparam("number"))
    .values(pose_map_lidar=bindparam("pose"))
)


@dataclass(frozen=True, slots=True, eq=False)
class SessionCommit:
    """The pipeline's commit, and what the session itself knows of the same frames.

    T_map_odom: (4, 4) by seq, of every frame in `commit`. rejected: (seq, stamp_ns, reason). holes: (seq, follows_seq).
    covariance: (6, 6) by seq, of those that have one. events: serialised splitslam.v1.Event.
    """

    commit: Commit
    T_map_odom: dict[int, np.ndarray]
    rejected: list[tuple[int, int, str]] = field(default_factory=list)
    holes: list[tuple[int, int]] = field(default_factory=list)
    statistics: str = ""
    finished: bool = False
    covariance: dict[int, np.ndarray] = field(default_factory=dict)
    events: list[bytes] = field(default_factory=list)

    @property
    def bytes(self) -> int:
        """Size of what it adds to the store, without the database's own overhead."""
        return (
            sum(len(k.cloud or b"") + 56 for k in self.commit.keyframes)
            + sum(len(f.payload) for f in self.commit.factors)
            + sum(len(descriptor) for _, descriptor in self.commit.places)
            + FRAME_ROW_BYTES * (len(self.commit.frames) + len(self.rejected))
            + history_bytes([h.what for h in self.commit.happened], self.events)
        )


def insert_rows(connection: Connection, key: int, entry: SessionCommit) -> None:
    """Everything a commit brings; the session's own row has been advanced before."""
    commit = entry.commit
    new_keyframes = {k.index: k for k in commit.keyframes}  # one that comes again replaces the one before
    frame_rows = _mapped_rows(key, entry) + _rejected_rows(key, entry)
    keyframe_rows = [
        {
            "session": key,
            "keyframe": k.index,
            "seq": k.seq,
            "stamp_ns": k.stamp_ns,
            "pose_map_lidar": pack_pose(k.T_map_lidar),
        }
        for k in new_keyframes.values()
    ]
    cloud_rows = [{"session": key, "keyframe": k.index, "cloud": k.cloud} for k in new_keyframes.values()]
    factor_rows = [{"session": key, "factor": f.index, "kind": f.kind, "payload": f.payload} for f in commit.factors]
    place_rows = [{"session": key, "keyframe": k, "descriptor": descriptor} for k, descriptor in commit.places]
    hole_rows = [{"session": key, "seq": seq, "follows_seq": follows} for seq, follows in entry.holes]
    if new_keyframes:
        _make_room(connection, key, list(new_keyframes))
    if place_rows:  # after one that is missing, those that a service has described again
        connection.execute(_DELETE_PLACES, {"key": key, "indices": [k for k, _ in commit.places]})
    for statement, rows in zip(
        _INSERTS, (frame_rows, keyframe_rows, cloud_rows, factor_rows, place_rows, hole_rows), strict=True
    ):
        if rows:
            connection.execute(statement, rows)
    if commit.frames_again:
        again = [{"key": key, "number": seq, "pose": pack_pose(T)} for seq, T in commit.frames_again]
        connection.execute(_PLACE_FRAME, again)
    if commit.keyframe_poses:
        moved = [{"key": key, "number": index, "pose": pack_pose(T)} for index, T in commit.keyframe_poses]
        connection.execute(_MOVE_KEYFRAME, moved)


def _mapped_rows(key: int, entry: SessionCommit) -> list[dict[str, object]]:
    frames = entry.commit.frames
    if not frames:
        return []
    n, odom = len(frames), [entry.T_map_odom[f.seq] for f in frames]
    packed = pack_all(np.array([f.T_keyframe_lidar for f in frames] + [f.T_map_lidar_online for f in frames] + odom))
    poses = zip(packed[:n], packed[n : 2 * n], packed[2 * n :], strict=True)
    covariances = pack_covariances([entry.covariance.get(f.seq) for f in frames])
    return [
        {
            "session": key,
            "seq": f.seq,
            "stamp_ns": f.stamp_ns,
            "state": int(f.state),
            "keyframe": f.keyframe,
            "pose_keyframe_lidar": keyframe_lidar,
            "online_map_lidar": map_lidar,
            "online_map_odom": map_odom,
            "rejected": "",
            "covariance": covariance,
        }
        for f, (keyframe_lidar, map_lidar, map_odom), covariance in zip(frames, poses, covariances, strict=True)
    ]


def _rejected_rows(key: int, entry: SessionCommit) -> list[dict[str, object]]:
    nothing = dict.fromkeys(("keyframe", "pose_keyframe_lidar", "online_map_lidar", "online_map_odom", "covariance"))
    return [
        {"session": key, "seq": seq, "stamp_ns": stamp_ns, "state": 0, "rejected": reason[:64], **nothing}
        for seq, stamp_ns, reason in entry.rejected
    ]


def _make_room(connection: Connection, key: int, indices: list[int]) -> None:
    """Remove what the keyframes replace, and count those that are new."""
    connection.execute(_DELETE_CLOUDS, {"key": key, "indices": indices})
    replaced = connection.execute(_DELETE_KEYFRAMES, {"key": key, "indices": indices}).rowcount
    connection.execute(_COUNT_KEYFRAMES, {"key": key, "new": len(indices) - replaced})
