"""All stored scans of a session: the oldest in blocks, the newest in rows of their own."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Row, select

from map_service import schema
from map_service.block_decoding import decode_block
from map_service.packing import unpack_all
from map_service.scans import Scans, StoredScan, scans_of_rows

_ROWS, _BLOCKS = 1000, 16  # at a time
_NEVER_NS = (1 << 63) - 1
_f, _b, _a = schema.frames, schema.pose_blocks, schema.anchors

Array = NDArray[np.float64]


class SessionScans:
    """Of session `key`, in one state of its store. Methods raise DataError for what was not written so."""

    def __init__(self, connection: Connection, key: int) -> None:
        self._connection, self._key = connection, key

    @cached_property
    def anchors(self) -> dict[int, Array]:
        """T_map_keyframe (4, 4) by keyframe, as the blocks refer to them."""
        query = select(_a.c.keyframe, _a.c.pose).where(_a.c.session == self._key)
        rows = self._connection.execute(query).all()
        return dict(zip((row.keyframe for row in rows), unpack_all([row.pose for row in rows]), strict=True))

    def decoded(self, block: Row) -> Scans:
        """A row of `schema.pose_blocks`."""
        return decode_block(block.content, self.anchors)

    def pages(self, after_seq: int = 0) -> Iterator[Scans]:
        """Those after `after_seq`, in order, some at a time."""
        query = select(_b).where(_b.c.session == self._key, _b.c.last_seq > after_seq).order_by(_b.c.first_seq)
        with self._connection.execute(query.execution_options(yield_per=_BLOCKS)) as result:
            for scans in map(self.decoded, result):
                yield scans.part(scans.seq > after_seq)
        rows = select(_f).where(_f.c.session == self._key, _f.c.seq > after_seq).order_by(_f.c.seq)
        with self._connection.execute(rows.execution_options(yield_per=_ROWS)) as result:
            yield from map(scans_of_rows, result.partitions())

    def after(self, seq: int, limit: int) -> list[StoredScan]:
        """The next ones after `seq`, at most `limit`."""
        found: list[StoredScan] = []
        while len(found) < limit:
            query = select(_b).where(_b.c.session == self._key, _b.c.last_seq > seq).order_by(_b.c.first_seq).limit(1)
            block = self._connection.execute(query).first()
            if block is None:
                break
            scans = self.decoded(block)
            found += scans.part(scans.seq > seq).part(slice(limit - len(found)))
            seq = block.last_seq
        if len(found) < limit:
            rows = select(_f).where(_f.c.session == self._key, _f.c.seq > seq).order_by(_f.c.seq)
            found += scans_of_rows(self._connection.execute(rows.limit(limit - len(found))).all())
        return found

    def newest(self, count: int) -> list[StoredScan]:
        """The last ones, in order of seq."""
        rows = select(_f).where(_f.c.session == self._key).order_by(_f.c.seq.desc()).limit(count)
        found = list(scans_of_rows(self._connection.execute(rows).all()[::-1]))
        blocks = select(_b).where(_b.c.session == self._key).order_by(_b.c.first_seq.desc())
        if len(found) < count:
            for block in self._connection.execute(blocks.limit(count - len(found))):
                found = [*self.decoded(block).part(slice(len(found) - count, None)), *found]
                if len(found) == count:
                    break
        return found

    def one(self, seq: int) -> StoredScan | None:
        """That number."""
        found = self.after(seq - 1, 1)
        return found[0] if found and found[0].seq == seq else None

    def before(self, stamp_ns: int) -> StoredScan | None:
        """The last one that was mapped not after a moment."""
        mapped = select(_f).where(_f.c.session == self._key, _f.c.rejected == "", _f.c.stamp_ns <= stamp_ns)
        row = self._connection.execute(mapped.order_by(_f.c.stamp_ns.desc()).limit(1)).first()
        if row is not None:
            return scans_of_rows([row]).scan(0)
        blocks = select(_b).where(_b.c.session == self._key, _b.c.first_stamp_ns <= stamp_ns)
        block = self._connection.execute(blocks.order_by(_b.c.first_seq.desc()).limit(1)).first()
        if block is None:
            return None
        scans = self.decoded(block)
        at = np.flatnonzero(scans.mapped & (scans.stamp_ns <= stamp_ns))
        return scans.scan(int(at[-1])) if len(at) else None

    def since(self, stamp_ns: int) -> StoredScan | None:
        """The first one that was mapped not before a moment."""
        blocks = select(_b).where(_b.c.session == self._key, _b.c.last_stamp_ns >= stamp_ns)
        block = self._connection.execute(blocks.order_by(_b.c.first_seq).limit(1)).first()
        if block is not None:
            scans = self.decoded(block)
            at = np.flatnonzero(scans.mapped & (scans.stamp_ns >= stamp_ns))
            return scans.scan(int(at[0])) if len(at) else None
        mapped = select(_f).where(_f.c.session == self._key, _f.c.rejected == "", _f.c.stamp_ns >= stamp_ns)
        row = self._connection.execute(mapped.order_by(_f.c.stamp_ns).limit(1)).first()
        return None if row is None else scans_of_rows([row]).scan(0)

    def newest_mapped(self) -> StoredScan | None:
        """The last one that was not rejected."""
        return self.before(_NEVER_NS)
