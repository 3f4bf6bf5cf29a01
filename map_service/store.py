"""The write side of the store: sessions are opened with a new epoch, commits are atomic and fenced.

The epoch is what makes one owner: opening a stream adds one, and a commit by an older epoch is refused.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from sqlalchemy import ColumnElement, Connection, Engine, Update, bindparam, case, func, insert, select, update
from sqlalchemy.exc import IntegrityError

from map_service import schema
from map_service.clouds import CloudsAwayError
from map_service.database import StoreError, open_engine, reading, store_errors
from map_service.event_messages import opened_event
from map_service.history import insert_events, insert_versions
from map_service.packing import unpack_pose
from map_service.rows import SessionCommit, insert_rows
from map_service.session_scans import SessionScans
from map_service.types import FactorRecord, KeyframeRecord, Snapshot

_CLOUDS_AT_ONCE = 256
_RACES = 8  # lost one after the other, when a session is opened by many


def _advance_statement() -> Update:
    """Compare and set on (epoch, last_seq). Made once: to make a statement costs more than to run it."""
    t = schema.sessions
    values: dict[str, ColumnElement] = {name: bindparam(f"to_{name}") for name in ("last_seq", "finished", "tracker")}
    for name in ("frames", "rejected", "loops", "gnss_factors", "bytes"):
        values[name] = t.c[name] + bindparam(f"new_{name}", type_=t.c[name].type)
    for name in ("finished_s", "statistics", "last_stamp_ns", "first_stamp_ns", "map_version"):  # None: as it was
        new: ColumnElement = bindparam(f"or_{name}", type_=t.c[name].type)
        if name == "first_stamp_ns":
            new = case((t.c.frames == 0, new))
        values[name] = func.coalesce(new, t.c[name])
    owned = t.c.id == bindparam("of_key"), t.c.epoch == bindparam("of_epoch"), t.c.finished.is_(False)
    return update(t).where(*owned, t.c.last_seq == bindparam("after_seq")).values(values)


_ADVANCE = _advance_statement()


class FencedError(Exception):
    """Another owner has opened the session since, or it is gone: nothing was written."""


class CloudsUnreadError(StoreError, CloudsAwayError):
    """The database fails while clouds are read, which a pipeline can wait for."""


class FinishedError(Exception):
    """The session has ended and is read-only."""


@dataclass(frozen=True, slots=True)
class Opening:
    """What a session is opened with; all but the ids is kept from the first opening."""

    session_id: str
    robot_id: str
    run_id: str
    site_id: str
    map_id: str
    robot_file: str


@dataclass(frozen=True, slots=True)
class OpenedSession:
    """A session as its new owner finds it. `statistics` is the JSON text of the last commit, or ""."""

    key: int
    epoch: int
    last_seq: int
    statistics: str


@dataclass(frozen=True, slots=True, eq=False)
class StoredAnswer:
    """The answer a frame was given. Transforms (4, 4) float64, None for a rejected frame."""

    seq: int
    stamp_ns: int
    state: int
    T_map_lidar: np.ndarray | None
    T_map_odom: np.ndarray | None
    rejected: str
    covariance: np.ndarray | None  # (6, 6); None: rejected, or not kept by the release that answered


class Store:
    """One engine in one process. Every method raises StoreError when the database fails."""

    def __init__(self, url: str, patience_s: float = 0.0) -> None:
        """Raises InputError; patience_s: how long to wait for a database that does not answer yet."""
        self.engine: Engine = open_engine(url, patience_s)
        self._writer = self.engine.execution_options(write=True)
        self._reader = reading(self.engine)

    def close(self) -> None:
        self.engine.dispose()

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A transaction that sees one state of the store throughout."""
        with store_errors(), self._reader.connect() as connection:
            yield connection

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        with store_errors(), self._writer.begin() as connection:
            yield connection

    def size_bytes(self) -> int:
        """Of the database as it lies on disk, everything included."""
        if self.engine.dialect.name == "sqlite":
            path = Path(str(self.engine.url.database))
            files = (path, path.with_name(path.name + "-wal"))
            return sum(file.stat().st_size for file in files if file.exists())
        with self.reading() as connection:
            return int(connection.execute(select(func.pg_database_size(func.current_database()))).scalar_one())

    def open_session(self, opening: Opening) -> OpenedSession:
        """Take the session over: its epoch grows by one. Raises FinishedError for one that has ended."""
        for _ in range(_RACES):
            try:
                opened = self._open_session(opening)
            except IntegrityError:  # another owner inserted it in the same moment: now it is there to be updated
                continue
            if opened is not None:
                return opened
        raise StoreError(f"{opening.session_id} is opened and deleted too often at once")

    def _open_session(self, opening: Opening) -> OpenedSession | None:
        """None: another owner inserted it between two looks."""
        t = schema.sessions
        with self.writing() as connection:
            taken = connection.execute(
                update(t)
                .where(t.c.session_id == opening.session_id, t.c.finished.is_(False))
                .values(epoch=t.c.epoch + 1)
            )
            row = connection.execute(
                select(t.c.id, t.c.epoch, t.c.last_seq, t.c.statistics, t.c.finished, t.c.last_stamp_ns).where(
                    t.c.session_id == opening.session_id
                )
            ).first()
            if row is None:
                key = connection.execute(insert(t).values(**_new_session(opening))).inserted_primary_key
                assert key is not None
                opened = OpenedSession(key[0], 1, 0, "")
            elif row.finished:
                raise FinishedError(opening.session_id)
            elif taken.rowcount == 1:
                opened = OpenedSession(*row[:4])
            else:
                return None
            event = opened_event(opened.epoch, opened.last_seq, 0 if row is None else row.last_stamp_ns)
            insert_events(connection, opened.key, [event.SerializeToString()])
            return opened

    def commit(self, key: int, epoch: int, entry: SessionCommit) -> None:
        """Write everything or nothing. Raises FencedError when (epoch, previous_seq) is not the store's.

        A commit whose outcome was lost may be tried again: the second time it finds itself done.
        """
        with self.writing() as connection:
            if not self._advance(connection, key, epoch, entry):
                return
            insert_rows(connection, key, entry)
            insert_versions(connection, key, [h.what for h in entry.commit.happened])
            insert_events(connection, key, entry.events)

    def _advance(self, connection: Connection, key: int, epoch: int, entry: SessionCommit) -> bool:
        commit = entry.commit
        kinds = [factor.kind for factor in commit.factors]
        stamps = [f.stamp_ns for f in commit.frames]  # a rejected frame's may be any number
        values = {
            "of_key": key,
            "of_epoch": epoch,
            "after_seq": commit.previous_seq,
            "to_last_seq": commit.last_seq,
            "to_finished": entry.finished,
            "to_tracker": commit.tracker,
            "new_frames": len(commit.frames),
            "new_rejected": len(entry.rejected),
            "new_loops": kinds.count("loop"),
            "new_gnss_factors": kinds.count("gnss"),
            "new_bytes": entry.bytes,
            "or_finished_s": time.time() if entry.finished else None,
            "or_statistics": entry.statistics or None,
            "or_last_stamp_ns": max(stamps, default=None),
            "or_first_stamp_ns": min(stamps, default=None),
            "or_map_version": commit.map_version or None,
        }
        if connection.execute(_ADVANCE, values).rowcount == 1:
            return True
        t = schema.sessions
        found = connection.execute(select(t.c.epoch, t.c.last_seq, t.c.finished).where(t.c.id == key)).first()
        if found is not None and tuple(found) == (epoch, commit.last_seq, entry.finished):
            return False
        raise FencedError(f"commit of epoch {epoch} after seq {commit.previous_seq}: the store has {found}")

    def load(self, key: int) -> Snapshot:
        """Everything MapPipeline.restore needs, but for the clouds: those it fetches as it needs them."""
        s, k, f, p = schema.sessions, schema.keyframes, schema.factors, schema.places
        with self.reading() as connection:
            query = select(s.c.last_seq, s.c.tracker, s.c.frames, s.c.map_version).where(s.c.id == key)
            last_seq, tracker, mapped, map_version = connection.execute(query).one()
            keyframes = connection.execute(
                select(k.c.keyframe, k.c.seq, k.c.stamp_ns, k.c.pose_map_lidar)
                .where(k.c.session == key)
                .order_by(k.c.keyframe)
            ).all()
            factors = connection.execute(
                select(f.c.factor, f.c.kind, f.c.payload).where(f.c.session == key).order_by(f.c.factor)
            ).all()
            places = connection.execute(
                select(p.c.keyframe, p.c.descriptor).where(p.c.session == key).order_by(p.c.keyframe)
            ).all()
        return Snapshot(
            last_seq=last_seq,
            keyframes=[KeyframeRecord(i, seq, ns, unpack_pose(pose), None) for i, seq, ns, pose in keyframes],
            factors=[FactorRecord(*row) for row in factors],
            tracker=tracker,
            mapped=mapped,
            map_version=map_version or 1,
            # up to the first that is missing: a service of the version before wrote none
            places=[descriptor for count, (i, descriptor) in enumerate(places) if i == count],
            fetch_clouds=partial(self.clouds, key),
        )

    def clouds(self, key: int, keyframes: Sequence[int]) -> dict[int, bytes]:
        """Their clouds. Raises CloudsUnreadError, or StoreError when one is not there: the session was deleted."""
        c = schema.clouds
        found: dict[int, bytes] = {}
        try:
            with self.reading() as connection:
                for first in range(0, len(keyframes), _CLOUDS_AT_ONCE):
                    some = keyframes[first : first + _CLOUDS_AT_ONCE]
                    query = select(c.c.keyframe, c.c.cloud).where(c.c.session == key, c.c.keyframe.in_(some))
                    found.update((row.keyframe, row.cloud) for row in connection.execute(query))
        except StoreError as error:
            raise CloudsUnreadError(str(error)) from error
        if missing := set(keyframes) - set(found):
            raise StoreError(f"no cloud of keyframe {min(missing)}")
        return found

    def answers(self, key: int, *, last: int = 0, seq: int = 0) -> list[StoredAnswer]:
        """The newest `last` answers and, if those are rejections, the newest that is none; or that of frame `seq`.

        In seq order.
        """
        with self.reading() as connection:
            scans = SessionScans(connection, key)
            found = scans.newest(last) if not seq else [one] if (one := scans.one(seq)) else []
            if last and all(scan.rejected for scan in found) and (mapped := scans.newest_mapped()):
                found = [mapped, *found]
        return [
            StoredAnswer(
                scan.seq,
                scan.stamp_ns,
                scan.state,
                None if scan.rejected else scan.T_map_lidar,
                None if scan.rejected else scan.T_map_odom,
                scan.rejected,
                scan.covariance,
            )
            for scan in found
        ]


def _new_session(opening: Opening) -> dict[str, object]:
    return {
        "session_id": opening.session_id,
        "robot_id": opening.robot_id,
        "run_id": opening.run_id,
        "site_id": opening.site_id,
        "map_id": opening.map_id,
        "robot_file": opening.robot_file,
        "opened_s": time.time(),
        "epoch": 1,
        "last_seq": 0,
        "finished": False,
        "first_stamp_ns": 0,
        "last_stamp_ns": 0,
        "frames": 0,
        "rejected": 0,
        "keyframes": 0,
        "loops": 0,
        "gnss_factors": 0,
        "bytes": 0,
        "tracker": b"",
        "statistics": "",
    }
