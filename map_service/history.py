"""What a session's map was before, as rows: versions with the poses they ended with, and events. Both are bounded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import BigInteger, Connection, bindparam, delete, func, insert, select, update

from map_service import schema
from map_service.happenings import Happening, MapMove
from splitslam.errors import DataError

KEPT_VERSIONS = 256  # of a session that can be asked for
KEPT_VERSIONS_BYTES = 16 << 20
KEPT_MOVES = 1000  # of a session whose cause and size are known
KEPT_EVENTS = 1000

_POSE_BYTES = 12 * 8
_v, _e, _s = schema.map_versions, schema.events, schema.sessions
_INSERT_VERSION, _INSERT_EVENT = insert(_v), insert(_e)
_COUNT_EVENTS = (
    update(_s)
    .where(_s.c.id == bindparam("key"))
    .values(events=func.coalesce(_s.c.events, 0) + bindparam("new", type_=BigInteger))
)
_NEWEST_EVENT = select(_s.c.events).where(_s.c.id == bindparam("key"))
_DELETE_EVENTS = delete(_e).where(_e.c.session == bindparam("key"), _e.c.number <= bindparam("up_to"))


def pack_poses(poses: NDArray[np.float64]) -> bytes:
    """(n, 4, 4) -> n * 96 bytes: the upper three rows of each, little-endian float64."""
    return np.ascontiguousarray(poses[:, :3], "<f8").tobytes()


def unpack_poses(data: bytes) -> NDArray[np.float64]:
    """The reverse. Raises DataError("corrupt")."""
    if len(data) % _POSE_BYTES:
        raise DataError("corrupt", f"poses of {len(data)} bytes")
    rows = np.frombuffer(data, "<f8").reshape(-1, 3, 4)
    if not np.isfinite(rows).all():
        raise DataError("corrupt", "a pose that is nowhere")
    poses = np.zeros((len(rows), 4, 4))
    poses[:, :3], poses[:, 3, 3] = rows, 1.0
    return poses


def history_bytes(happened: Sequence[Happening], events: Sequence[bytes]) -> int:
    """What these rows add to a store."""
    return sum(map(len, events)) + sum(len(what.T_map_lidar) * _POSE_BYTES for what in _moves(happened))


def insert_versions(connection: Connection, key: int, happened: Sequence[Happening]) -> None:
    """The versions that have begun; poses of old ones make room."""
    rows = [
        {
            "session": key,
            "version": move.version,
            "first_seq": move.first_seq,
            "cause": int(move.cause),
            "translation_m": move.translation_m,
            "rotation_rad": move.rotation_rad,
            "poses": pack_poses(move.T_map_lidar),
        }
        for move in _moves(happened)
    ]
    if rows:
        connection.execute(_INSERT_VERSION, rows)
        _forget_poses(connection, key)
        newest = rows[-1]["version"]
        connection.execute(delete(_v).where(_v.c.session == key, _v.c.version <= newest - KEPT_MOVES))


def _forget_poses(connection: Connection, key: int) -> None:
    query = select(_v.c.version, func.length(_v.c.poses)).where(_v.c.session == key, _v.c.poses.is_not(None))
    kept, total, forgotten = 0, 0, 0
    for version, size in connection.execute(query.order_by(_v.c.version.desc())).all():
        kept, total = kept + 1, total + size
        if kept > 1 and (kept > KEPT_VERSIONS or total > KEPT_VERSIONS_BYTES):
            row = _v.c.session == key, _v.c.version == version
            connection.execute(update(_v).where(*row).values(poses=None))
            forgotten += size
    if forgotten:
        connection.execute(update(_s).where(_s.c.id == key).values(bytes=_s.c.bytes - forgotten))


def insert_events(connection: Connection, key: int, contents: Sequence[bytes]) -> None:
    """Serialised events with the next numbers; the session's row is locked by what came before."""
    if not contents:
        return
    connection.execute(_COUNT_EVENTS, {"key": key, "new": len(contents)})
    newest = connection.execute(_NEWEST_EVENT, {"key": key}).scalar_one()
    first = newest - len(contents) + 1
    rows = [{"session": key, "number": first + i, "content": content} for i, content in enumerate(contents)]
    connection.execute(_INSERT_EVENT, rows)
    if newest > KEPT_EVENTS:
        connection.execute(_DELETE_EVENTS, {"key": key, "up_to": newest - KEPT_EVENTS})


def _moves(happened: Sequence[Happening]) -> Iterator[MapMove]:
    return (what for what in happened if isinstance(what, MapMove))
