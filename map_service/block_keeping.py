"""Scans that nobody changes any more move from their rows into blocks, and old blocks are thinned.

What moves is written and deleted in one transaction, so that whatever dies, each scan is in one place. It is computed
before: on a busy machine that takes longer than the second after which PostgreSQL ends an idle transaction, and
meanwhile nothing of the session could be committed. The newest scans stay rows: a robot that was lost and is found has
those of its way placed anew (map_service/carried.py).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, Row, Table, delete, func, insert, select, update

from map_service import carried, migrations, schema
from map_service.block_checking import check_block
from map_service.block_encoding import encode_block, first_seen
from map_service.config import PosesConfig
from map_service.database import alone
from map_service.fidelity import FULL, Fidelity, thinned
from map_service.packing import pack_all, pack_factors, pack_pose
from map_service.rows import FRAME_ROW_BYTES
from map_service.scans import Scans, joined, scans_of_rows
from map_service.session_scans import SessionScans
from map_service.store import Store
from splitslam.errors import DataError
from splitslam.logs import fields

SCANS = 512  # of a block
MERGED = 8  # blocks that become one when they are thinned
OPEN = carried.MOST  # mapped scans that stay rows while the session goes on
_BLOCK_BYTES = 60  # of a row of `pose_blocks` besides its content
_SINCE = 5  # the version of the store that knows blocks
_HOUR_NS = 3_600_000_000_000

_s, _f, _b, _a = schema.sessions, schema.frames, schema.pose_blocks, schema.anchors
Array = NDArray[np.float64]
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Kept:
    """What one run did: scans that moved from rows into blocks, scans that have no pose of their own any more."""

    closed: int = 0
    thinned: int = 0

    def __add__(self, other: Kept) -> Kept:
        return Kept(self.closed + other.closed, self.thinned + other.thinned)


@dataclass(frozen=True, slots=True)
class _Step:
    """A block that takes the place of rows of one table, `old`. anchors, values: rows to come; freed: bytes."""

    table: Table
    old: list[Row]
    of_old: Sequence[ColumnElement[bool]]
    anchors: list[dict[str, Any]]
    values: dict[str, Any]
    freed: int
    kept: Kept

    def fits(self, connection: Connection) -> bool:
        """Is what it was computed from still what the store has?"""
        _, number = self.table.primary_key.columns
        return connection.execute(select(self.table).where(*self.of_old).order_by(number)).all() == self.old

    def write(self, connection: Connection) -> None:
        if self.anchors:
            connection.execute(insert(_a), self.anchors)
        deleted = connection.execute(delete(self.table).where(*self.of_old)).rowcount
        assert deleted == len(self.old), f"{deleted} rows deleted, {len(self.old)} read"
        connection.execute(insert(_b).values(self.values))
        size = len(self.values["content"]) + _BLOCK_BYTES - self.freed
        of_session = _s.c.id == self.values["session"]
        connection.execute(update(_s).where(of_session).values(bytes=_s.c.bytes + size))


class BlockKeeper:
    """Of one store; replicas may run it side by side."""

    def __init__(self, store: Store, config: PosesConfig) -> None:
        self._store, self._config = store, config
        self._thin = thinned(config.within_m, math.radians(config.within_deg))
        self._settled: set[int] = set()  # sessions that have ended, and of which nothing is left to do

    def run(self, now_s: float, most: int = 200) -> Kept:
        """At most so many transactions. now_s: Unix time. Raises StoreError; what was done until then is."""
        done, left = Kept(), most
        for key in self._due(now_s):
            try:
                while left > 0 and (one := self._step(key, now_s)) is not None:
                    done, left = done + one, left - 1
            except DataError as error:
                self._settled.add(key)
                _log.warning(
                    "scans that cannot be read stay as they are",
                    extra=fields(session_id=self._name(key), detail=str(error)),
                )
        return done

    def _name(self, key: int) -> str | None:
        with self._store.reading() as connection:
            return connection.execute(select(_s.c.session_id).where(_s.c.id == key)).scalar()

    def _due(self, now_s: float) -> list[int]:
        """Sessions to look at. None while services of the version before may still be running: they know rows alone."""
        with self._store.reading() as connection:
            since_s = migrations.since(connection).get(_SINCE)  # None: it was made with them
            if since_s is not None and now_s < since_s + self._config.upgrade_h * 3600.0:
                return []
            keys = connection.execute(select(_s.c.id).order_by(_s.c.id)).scalars()
            return [key for key in keys if key not in self._settled]

    def _step(self, key: int, now_s: float) -> Kept | None:
        """The next thing to do with a session, in one transaction; None: there is nothing."""
        with self._store.reading() as connection:
            row = connection.execute(_session(key)).first()
            step = None if row is None else self._next(connection, row, now_s)
            if step is None:
                if row is None or (row.finished and not self._thins_later(connection, row)):
                    self._settled.add(key)
                return None
        with self._store.writing() as connection:
            # locked: a commit of the session comes before all of this or after it
            row = connection.execute(_session(key).with_for_update()).first() if alone(connection) else None
            if row is None or not step.fits(connection):
                return None
            step.write(connection)
        return step.kept

    def _next(self, connection: Connection, row: Row, now_s: float) -> _Step | None:
        """Computed, and not yet written. Raises DataError when a block cannot tell the scans."""
        if _may_close(connection, row) and (rows := _closable(connection, row)):
            return _closing(connection, row.id, rows)
        if blocks := self._thinnable(connection, row, now_s):
            return _merging(connection, row.id, blocks, self._thin)
        return None

    # -- thinning -----------------------------------------------------------------------------------------------

    def _thinnable(self, connection: Connection, row: Row, now_s: float) -> list[Row]:
        """The oldest blocks that are not thinned and older than the full rate is kept; as many as become one."""
        if self._config.full_rate_h == 0:
            return []
        newest_ns = row.last_stamp_ns + (int((now_s - (row.finished_s or now_s)) * 1e9) if row.finished else 0)
        limit_ns = newest_ns - int(self._config.full_rate_h * _HOUR_NS)
        query = select(_b).where(_b.c.session == row.id, _b.c.thinned.is_(None)).order_by(_b.c.first_seq)
        blocks = connection.execute(query.limit(MERGED)).all()
        old = [block for block in blocks if block.last_stamp_ns is None or block.last_stamp_ns < limit_ns]
        return old if len(old) == MERGED or (row.finished and len(old) == len(blocks)) else []

    def _thins_later(self, connection: Connection, row: Row) -> bool:
        query = select(_b.c.first_seq).where(_b.c.session == row.id, _b.c.thinned.is_(None)).limit(1)
        return self._config.full_rate_h > 0 and connection.execute(query).first() is not None


def _session(key: int):
    columns = _s.c.id, _s.c.finished, _s.c.finished_s, _s.c.last_seq, _s.c.last_stamp_ns
    return select(*columns).where(_s.c.id == key)


def _may_close(connection: Connection, session: Row) -> bool:
    """Are there as many rows as it takes? Asks the primary key alone."""
    numbers = select(_f.c.seq).where(_f.c.session == session.id).order_by(_f.c.seq)
    enough = 0 if session.finished else OPEN + SCANS - 1
    return connection.execute(numbers.offset(enough).limit(1)).first() is not None


def _closable(connection: Connection, session: Row) -> list[Row]:
    """The oldest rows, as many as make a block; of a session that has ended all that are left."""
    last_seq = session.last_seq
    if not session.finished:
        mapped = select(_f.c.seq).where(_f.c.session == session.id, _f.c.rejected == "")
        last_seq = connection.execute(mapped.order_by(_f.c.seq.desc()).offset(OPEN).limit(1)).scalar() or 0
    query = select(_f).where(_f.c.session == session.id, _f.c.seq <= last_seq).order_by(_f.c.seq).limit(SCANS)
    rows = list(connection.execute(query))
    return rows if len(rows) == SCANS or session.finished else []


def _closing(connection: Connection, key: int, rows: list[Row]) -> _Step:
    scans = scans_of_rows(rows)
    anchors = SessionScans(connection, key).anchors
    new = {keyframe: T for keyframe, T in first_seen(scans).items() if keyframe not in anchors}
    anchor_rows = [{"session": key, "keyframe": k, "pose": pack_pose(T)} for k, T in new.items()]
    moved = _f.c.session == key, _f.c.seq >= rows[0].seq, _f.c.seq <= rows[-1].seq
    values, _ = _block(key, scans, anchors | new, FULL)
    return _Step(_f, rows, moved, anchor_rows, values, FRAME_ROW_BYTES * len(rows), Kept(closed=len(rows)))


def _merging(connection: Connection, key: int, blocks: list[Row], fidelity: Fidelity) -> _Step:
    """They become one of fewer poses."""
    known = SessionScans(connection, key)
    scans = joined([known.decoded(block) for block in blocks])
    of_them = _b.c.session == key, _b.c.first_seq.in_([block.first_seq for block in blocks])
    freed = sum(len(block.content) + _BLOCK_BYTES for block in blocks)
    values, left_out = _block(key, scans, known.anchors, fidelity)
    return _Step(_b, blocks, of_them, [], values, freed, Kept(thinned=left_out))


def _block(key: int, scans: Scans, anchors: dict[int, Array], fidelity: Fidelity) -> tuple[dict[str, Any], int]:
    """A block's row, and how many scans have no pose of their own in it.

    Raises DataError when a block cannot tell them.
    """
    content, left_out = encode_block(scans, anchors, fidelity)
    check_block(content, scans, anchors, fidelity)
    stamps_ns = scans.stamp_ns[scans.mapped].tolist()
    values = {
        "session": key,
        "first_seq": int(scans.seq[0]),
        "last_seq": int(scans.seq[-1]),
        "first_stamp_ns": stamps_ns[0] if stamps_ns else None,
        "last_stamp_ns": stamps_ns[-1] if stamps_ns else None,
        "scans": len(scans),
        "thinned": left_out if fidelity.thins else None,
        "content": content,
    }
    return values, left_out


def reopen(connection: Connection) -> None:
    """Every scan has a row again, as the version before blocks has it; thinned ones as the others tell them."""
    for key in connection.execute(select(_s.c.id).order_by(_s.c.id)).scalars().all():
        size = func.coalesce(func.sum(func.length(_b.c.content) + _BLOCK_BYTES), 0)
        freed = connection.execute(select(size).where(_b.c.session == key)).scalar_one()
        for first_seq in connection.execute(select(_b.c.first_seq).where(_b.c.session == key)).scalars().all():
            block = connection.execute(select(_b).where(_b.c.session == key, _b.c.first_seq == first_seq)).one()
            scans = SessionScans(connection, key).decoded(block)
            connection.execute(insert(_f), _rows(key, scans))
            freed -= FRAME_ROW_BYTES * len(scans)
        connection.execute(delete(_b).where(_b.c.session == key))
        connection.execute(update(_s).where(_s.c.id == key).values(bytes=_s.c.bytes - freed))


def _rows(key: int, scans: Scans) -> list[dict[str, Any]]:
    """As rows.py writes them."""
    poses = scans.T_keyframe_lidar, scans.T_map_lidar, scans.T_map_odom
    names = "pose_keyframe_lidar", "online_map_lidar", "online_map_odom", "covariance"
    packed = list(zip(*map(pack_all, poses), pack_factors(scans.factor), strict=True))
    nothing = (None,) * len(names)
    return [
        {
            "session": key,
            "seq": scan.seq,
            "stamp_ns": scan.stamp_ns,
            "state": scan.state,
            "keyframe": None if scan.rejected else scan.keyframe,
            "rejected": scan.rejected,
            **dict(zip(names, nothing if scan.rejected else content, strict=True)),
        }
        for scan, content in zip(scans, packed, strict=True)
    ]
