"""A commit as rows of the store's tables."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from sqlalchemy import BigInteger, Connection, Delete, Table, bindparam, delete, insert, update

from map_service import schema
from map_service.history import history_bytes
from map_service.types import Commit
from splitslam import se3
from splitslam.errors import DataError

_POSE_BYTES = 7 * 8
_FAR = 1e12
_LOWER = np.tril_indices(6)
_FACTOR_SCALE, _FLOAT16_MAX = 1e3, 65504.0  # sigmas from 6e-11 to 65 rad or m
_COVARIANCE_BYTES = len(_LOWER[0]) * 2
_FRAME_ROW_BYTES = 3 * _POSE_BYTES + _COVARIANCE_BYTES + 40


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
            + _FRAME_ROW_BYTES * (len(self.commit.frames) + len(self.rejected))
            + history_bytes([h.what for h in self.commit.happened], self.events)
        )


def pack_pose(T: np.ndarray) -> bytes:
    """(4, 4) -> 56 bytes: x y z, qx qy qz qw, little-endian float64."""
    return np.concatenate([T[:3, 3], se3.quat_from_matrix(T[:3, :3])]).astype("<f8").tobytes()


def unpack_pose(data: bytes | None) -> np.ndarray:
    """56 bytes -> (4, 4). Raises DataError("corrupt") for what cannot be a pose."""
    if data is None or len(data) != _POSE_BYTES:
        raise DataError("corrupt", f"a pose of {0 if data is None else len(data)} bytes")
    values = np.frombuffer(data, "<f8")
    if not np.abs(values).max() < _FAR:  # NaN as well
        raise DataError("corrupt", "a pose that is nowhere")
    if not values[3:].any():
        raise DataError("corrupt", "a pose without a rotation")
    return se3.from_quat(values[:3], values[3:])


def pack_covariance(covariance: np.ndarray | None) -> bytes | None:
    """(6, 6) -> 42 bytes: its Cholesky factor's lower triangle in mrad and mm, row by row, little-endian float16.

    None for what is no covariance. A factor, so that rounding cannot make a direction of negative variance.
    """
    if covariance is None or not np.isfinite(covariance).all():
        return None
    try:
        factor = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:  # known to rounding along some direction
        variances, axes = np.linalg.eigh(covariance)
        factor = np.linalg.qr((axes * np.sqrt(np.maximum(variances, 0.0))).T).R.T
    return np.clip(factor[_LOWER] * _FACTOR_SCALE, -_FLOAT16_MAX, _FLOAT16_MAX).astype("<f2").tobytes()


def unpack_covariance(data: bytes | None) -> np.ndarray | None:
    """42 bytes -> (6, 6), each entry to 2e-3 of its two sigmas. Raises DataError("corrupt")."""
    if data is None:
        return None
    if len(data) != _COVARIANCE_BYTES:
        raise DataError("corrupt", f"a covariance of {len(data)} bytes")
    factor = np.zeros((6, 6))
    factor[_LOWER] = np.frombuffer(data, "<f2").astype(float) / _FACTOR_SCALE
    if not np.isfinite(factor).all():
        raise DataError("corrupt", "a covariance without numbers")
    return factor @ factor.T


def insert_rows(connection: Connection, key: int, entry: SessionCommit) -> None:
    """Everything a commit brings; the session's own row has been advanced before."""
    commit = entry.commit
    new_keyframes = {k.index: k for k in commit.keyframes}  # one that comes again replaces the one before
    frame_rows = [
        {
            "session": key,
            "seq": f.seq,
            "stamp_ns": f.stamp_ns,
            "state": int(f.state),
            "keyframe": f.keyframe,
            "pose_keyframe_lidar": pack_pose(f.T_keyframe_lidar),
            "online_map_lidar": pack_pose(f.T_map_lidar_online),
            "online_map_odom": pack_pose(entry.T_map_odom[f.seq]),
            "rejected": "",
            "covariance": pack_covariance(entry.covariance.get(f.seq)),
        }
        for f in commit.frames
    ] + [
        {
            "session": key,
            "seq": seq,
            "stamp_ns": stamp_ns,
            "state": 0,
            "keyframe": None,
            "pose_keyframe_lidar": None,
            "online_map_lidar": None,
            "online_map_odom": None,
            "rejected": reason[:64],
            "covariance": None,
        }
        for seq, stamp_ns, reason in entry.rejected
    ]
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


def _make_room(connection: Connection, key: int, indices: list[int]) -> None:
    """Remove what the keyframes replace, and count those that are new."""
    connection.execute(_DELETE_CLOUDS, {"key": key, "indices": indices})
    replaced = connection.execute(_DELETE_KEYFRAMES, {"key": key, "indices": indices}).rowcount
    connection.execute(_COUNT_KEYFRAMES, {"key": key, "new": len(indices) - replaced})
