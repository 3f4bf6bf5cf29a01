"""The read side of the store for operators and tools: list, get, delete, trajectory, keyframes."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from sqlalchemy import Connection, Row, Table, delete, func, null, select

from map_service import schema
from map_service.packing import unpack_pose
from map_service.session_scans import SessionScans
from map_service.store import Store
from map_service.types import FactorRecord
from splitslam.errors import DataError

_AT_ONCE, _ROWS_AT_ONCE = {"dense_clouds": 50, "clouds": 500}, 20_000  # rows that a statement deletes


@dataclass(frozen=True, slots=True)
class Deleted:
    """What a delete removed."""

    frames: int
    keyframes: int
    bytes: int


@dataclass(frozen=True, slots=True, eq=False)
class StoredKeyframe:
    """One keyframe of the map. T_map_lidar: (4, 4) as corrected last; cloud: map_service.cloud's encoding.

    stamp_ns: reference time of its scan. dense: its whole scan (splitslam.dense_cloud), None where there is none.
    """

    index: int
    stamp_ns: int
    T_map_lidar: np.ndarray
    cloud: bytes
    dense: bytes | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StoredGraph:
    """A session's graph. keyframes: (index, stamp_ns, T_map_lidar (4, 4)); tracker: as persistence.py writes it."""

    keyframes: list[tuple[int, int, np.ndarray]]
    factors: list[FactorRecord]
    tracker: bytes


class Catalog:
    """Queries over one store; sessions are named by their session id."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def sessions(self, site_id: str = "") -> list[Row]:
        """Rows of `schema.sessions` in the order they were opened; all sites for ""."""
        t = schema.sessions
        query = select(t).order_by(t.c.id)
        with self._store.reading() as connection:
            return list(connection.execute(query.where(t.c.site_id == site_id) if site_id else query))

    def session(self, session_id: str) -> Row | None:
        t = schema.sessions
        with self._store.reading() as connection:
            return connection.execute(select(t).where(t.c.session_id == session_id)).first()

    def epochs(self, keys: Iterable[int]) -> dict[int, int]:
        """By key: how often each session has been opened; without those that are not there."""
        t = schema.sessions
        with self._store.reading() as connection:
            rows = connection.execute(select(t.c.id, t.c.epoch).where(t.c.id.in_(list(keys)))).all()
        return {row.id: row.epoch for row in rows}

    def delete(self, session_id: str) -> Deleted | None:
        """Remove a session with everything it stored; None: there is none."""
        with self._store.writing() as connection:
            return delete_session(connection, session_id)

    def trajectory(self, key: int) -> Iterator[list[tuple[int, int, np.ndarray]]]:
        """Chunks of (seq, stamp_ns, T_map_lidar (4, 4)) in seq order, mapped frames only.

        Raises DataError for rows that do not hold together.
        """
        k = schema.keyframes
        with self._store.reading() as connection:  # one read transaction: poses before and after a loop never mix
            poses = {
                index: unpack_pose(pose)
                for index, pose in connection.execute(
                    select(k.c.keyframe, k.c.pose_map_lidar).where(k.c.session == key)
                )
            }
            for scans in SessionScans(connection, key).pages():
                page = scans.part(scans.mapped)
                numbers = page.keyframe.tolist()
                if lost := next(
                    (seq for seq, k in zip(page.seq.tolist(), numbers, strict=True) if k not in poses), None
                ):
                    raise DataError("corrupt", f"frame {lost} is on a keyframe that is not there")
                if len(page):
                    now = np.array([poses[keyframe] for keyframe in numbers]) @ page.T_keyframe_lidar
                    yield list(zip(page.seq.tolist(), page.stamp_ns.tolist(), now, strict=True))

    def keyframes(self, key: int, first: int = 0, *, dense: bool = False) -> Generator[StoredKeyframe]:
        """Every keyframe from number `first` on with its cloud, one at a time; dense: and its whole scan."""
        k, c, d = schema.keyframes, schema.clouds, schema.dense_clouds
        of_both = (k.c.session == c.c.session) & (k.c.keyframe == c.c.keyframe)
        columns = (k.c.keyframe, k.c.stamp_ns, k.c.pose_map_lidar, c.c.cloud)
        query = select(*columns, d.c.cloud) if dense else select(*columns, null())
        query = query.join_from(k, c, of_both)
        if dense:
            query = query.outerjoin(d, (k.c.session == d.c.session) & (k.c.keyframe == d.c.keyframe))
        query = query.where(k.c.session == key, k.c.keyframe >= first).order_by(k.c.keyframe)
        # of the statement, not the connection: what begins a transaction on PostgreSQL is no query to page through
        query = query.execution_options(yield_per=16)
        with self._store.reading() as connection, connection.execute(query) as rows:
            for index, stamp_ns, pose, cloud, whole in rows:
                yield StoredKeyframe(index, stamp_ns, unpack_pose(pose), cloud, whole)

    def graph(self, key: int) -> StoredGraph:
        """A session's factor graph: where its keyframes are, every factor, and the small state of its pipeline."""
        k, f = schema.keyframes, schema.factors
        with self._store.reading() as connection:
            tracker = connection.execute(select(schema.sessions.c.tracker).where(schema.sessions.c.id == key)).scalar()
            poses = select(k.c.keyframe, k.c.stamp_ns, k.c.pose_map_lidar).where(k.c.session == key)
            keyframes = [(i, ns, unpack_pose(pose)) for i, ns, pose in connection.execute(poses.order_by(k.c.keyframe))]
            query = select(f.c.factor, f.c.kind, f.c.payload).where(f.c.session == key).order_by(f.c.factor)
            factors = [FactorRecord(*row) for row in connection.execute(query)]
        return StoredGraph(keyframes, factors, tracker or b"")

    def bytes_by_site(self) -> dict[str, int]:
        """What the sessions of each site have written, without the database's own overhead."""
        t = schema.sessions
        query = select(t.c.site_id, func.sum(t.c.bytes)).group_by(t.c.site_id)
        with self._store.reading() as connection:
            return {site: int(size) for site, size in connection.execute(query)}


def delete_session(connection: Connection, session_id: str) -> Deleted | None:
    """Every row of a session, within a transaction that writes; None: there is none."""
    t = schema.sessions
    # locked: a commit of its owner either comes before all of this or finds nothing to write to
    query = select(t.c.id, t.c.bytes, t.c.frames, t.c.rejected).where(t.c.session_id == session_id).with_for_update()
    row = connection.execute(query).first()
    if row is None:
        return None
    removed = {table.name: _delete_rows(connection, table, row.id) for table in schema.SESSION_TABLES}
    connection.execute(delete(t).where(t.c.id == row.id))
    return Deleted(row.frames + row.rejected, removed["keyframes"], row.bytes)


def _delete_rows(connection: Connection, table: Table, key: int) -> int:
    """A session's rows of one table, some at a time: a statement has to end within seconds (postgres.py), and gigabytes
    of whole scans do not go in that time."""
    _, number = table.primary_key.columns
    at_once, removed = _AT_ONCE.get(table.name, _ROWS_AT_ONCE), 0
    some = select(number).where(table.c.session == key).limit(at_once)
    while count := connection.execute(delete(table).where(table.c.session == key, number.in_(some))).rowcount:
        removed += count
        if count < at_once:
            break
    return removed
