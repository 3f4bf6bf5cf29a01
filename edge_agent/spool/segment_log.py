"""Frames in append-only files of bounded size; a file goes when nothing in it is needed any more.

What is appended has reached the kernel when `append` returns: it survives the death of the process. `sync` makes it
survive a power cut. One thread appends, reads and removes; `sync` may be called from another.
"""

from __future__ import annotations

import contextlib
import errno
import os
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from edge_agent.spool.record import DROPPED_MARK, KEPT_AT, Damage, Found, Head, pack, unpack, walk

SUFFIX = ".seg"
Write = Callable[[int, bytes], int]


class DamagedError(Exception):
    """A record is not what was written."""


@dataclass(slots=True, eq=False)
class _Segment:
    """One file. live: bytes of the records that are still needed; whole: bytes of the file."""

    path: Path
    whole: int = 0
    live: int = 0
    seqs: set[int] = field(default_factory=set)
    dirty: bool = False


@dataclass(frozen=True, slots=True)
class _Place:
    segment: _Segment
    offset: int
    head: Head


@dataclass(frozen=True, slots=True)
class Recovery:
    """What a folder held. heads: of the newest copy of each kept frame, by seq. newest: of all, given up or not.

    damaged: frames that cannot be read any more, as far as their neighbours tell; torn: of these, cut-off ends.
    """

    heads: list[Head]
    newest: Head | None
    durable_seq: int
    damaged: int
    torn: int

    @property
    def says_how_far(self) -> bool:
        """No frame after `newest` was sent: one whose writing was cut off was not."""
        return self.newest is not None and self.damaged == self.torn


class SegmentLog:
    """The records of one run by seq. `write` is os.write, and the seam at which tests let a disk fail."""

    def __init__(self, folder: Path, segment_bytes: int, write: Write = os.write) -> None:
        self._folder, self._segment_bytes, self._write = folder, segment_bytes, write
        self._places: OrderedDict[int, _Place] = OrderedDict()
        self._segments: dict[Path, _Segment] = {}
        self._active: _Segment | None = None
        self._fd = -1
        self._lock = threading.Lock()  # guards which files are open and dirty
        self._number = 0
        self.bytes = 0  # of the files
        self.live_bytes = 0  # of the records that are needed

    def __len__(self) -> int:
        return len(self._places)

    def __contains__(self, seq: int) -> bool:
        return seq in self._places

    # --- a start ----------------------------------------------------------------------------------------------

    def recover(self) -> Recovery:
        """Reads every file and verifies every record; call it once, first. Raises OSError."""
        kept: dict[int, _Place] = {}
        everything: list[Head] = []
        given_up: set[int] = set()
        gaps: list[tuple[Head | None, Head | None, bool]] = []
        for path in sorted(self._folder.glob(f"[0-9]*{SUFFIX}")):
            data = path.read_bytes()
            segment = self._segments[path] = _Segment(path, len(data), dirty=True)
            self._number = max(self._number, int(path.stem))
            self.bytes += len(data)
            items = walk(data)
            for k, item in enumerate(items):
                if isinstance(item, Damage):
                    gaps.append((_head(items, k - 1), _head(items, k + 1), item.torn))
                    continue
                everything.append(item.head)
                given_up |= set() if item.kept else {item.head.seq}
                kept[item.head.seq] = _Place(segment, item.offset, item.head)
        for seq in sorted(set(kept) - given_up):
            self._keep(seq, kept[seq])
        for segment in list(self._segments.values()):
            self._delete_if_useless(segment)
        known = {head.seq for head in everything}
        return Recovery(
            heads=[place.head for place in self._places.values()],
            newest=max(everything, key=lambda head: head.seq, default=None),
            durable_seq=max((head.durable_seq for head in everything), default=0),
            damaged=sum(_missing(before, after, known) for before, after, _ in gaps),
            torn=sum(torn for _, _, torn in gaps),
        )

    # --- records ----------------------------------------------------------------------------------------------

    def append(self, head: Head, body: bytes) -> None:
        """Writes a frame. Raises OSError; then nothing of it is left."""
        self._write_record(head, pack(head, body))

    def _write_record(self, head: Head, data: bytes) -> None:
        try:
            self._try_to_write(head, data)
        except OSError:
            useless = [segment for segment in self._segments.values() if not segment.seqs]
            if not useless:
                raise
            for segment in useless:  # the file that says how far the run has come may be what fills the disk
                self._delete(segment)
            self._try_to_write(head, data)

    def _try_to_write(self, head: Head, data: bytes) -> None:
        segment = self._segment_for(len(data))
        try:
            if (written := self._write(self._fd, data)) != len(data):
                raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)} ({written} of {len(data)} bytes written)")
        except OSError:
            self._abandon(segment)
            raise
        first = segment.whole == 0
        place = _Place(segment, segment.whole, head)
        segment.whole += len(data)
        self.bytes += len(data)
        segment.dirty = True
        self._keep(head.seq, place)
        if first:
            for older in list(self._segments.values()):
                self._delete_if_useless(older)

    def read(self, seq: int) -> bytes:
        """The frame's body. Raises OSError or DamagedError."""
        place = self._places[seq]
        with place.segment.path.open("rb") as file:
            file.seek(place.offset)
            record = unpack(file.read(place.head.record_bytes))
        if record is None or record[0].head != place.head:
            raise DamagedError(f"{place.segment.path}: frame {seq} at {place.offset}")
        return record[1]

    def release(self, seq: int) -> None:
        """The frame is not needed any more: the service has it. Raises OSError."""
        place = self._places.pop(seq)
        self._unneeded(place)
        self._delete_if_useless(place.segment)

    def give_up(self, seq: int) -> None:
        """The frame is lost for good: marked, so that a restart does not bring it back. Raises OSError."""
        place = self._places[seq]
        self.release(seq)
        if place.segment.path in self._segments:
            with place.segment.path.open("r+b") as file:
                file.seek(place.offset + KEPT_AT)
                file.write(DROPPED_MARK)
            place.segment.dirty = True

    def shrink(self, limit_bytes: int) -> None:
        """Copies what is needed out of the emptiest files until all are within the limit. Raises OSError."""
        while self.bytes > limit_bytes:
            sealed = [s for s in self._segments.values() if s is not self._active and s.live < s.whole]
            if not sealed:
                return
            segment = max(sealed, key=lambda s: s.whole - s.live)
            data = segment.path.read_bytes()
            for seq in sorted(segment.seqs):
                place = self._places[seq]
                self._write_record(place.head, data[place.offset : place.offset + place.head.record_bytes])
            self._delete_if_useless(segment)

    def _keep(self, seq: int, place: _Place) -> None:
        """The record there is the one that counts from now on."""
        if (before := self._places.get(seq)) is not None:
            self._unneeded(before)
        self._places[seq] = place
        place.segment.seqs.add(seq)
        place.segment.live += place.head.record_bytes
        self.live_bytes += place.head.record_bytes

    def _unneeded(self, place: _Place) -> None:
        place.segment.seqs.discard(place.head.seq)
        place.segment.live -= place.head.record_bytes
        self.live_bytes -= place.head.record_bytes

    # --- files ------------------------------------------------------------------------------------------------

    def _segment_for(self, size: int) -> _Segment:
        if self._active is not None and self._active.whole + size <= self._segment_bytes:
            return self._active
        self._folder.mkdir(parents=True, exist_ok=True)  # it could not be made when the disk was full
        self._number += 1
        path = self._folder / f"{self._number:08d}{SUFFIX}"
        fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o600)
        segment = self._segments[path] = _Segment(path)
        self._swap(fd, segment)
        return segment

    def _swap(self, fd: int, segment: _Segment | None) -> None:
        with self._lock:
            if self._fd >= 0:
                os.close(self._fd)
            self._fd, self._active = fd, segment

    def _abandon(self, segment: _Segment) -> None:
        """A write failed: what it may have left is cut off, and the next one goes to a new file."""
        with contextlib.suppress(OSError):  # a restart would find a torn end and skip it
            os.ftruncate(self._fd, segment.whole)
        self._swap(-1, None)
        self._delete_if_useless(segment)

    def _delete_if_useless(self, segment: _Segment) -> None:
        """The newest file with a record stays: it says how far the run has come."""
        if segment.seqs or segment is self._active or segment.path not in self._segments:
            return
        if segment.whole and not any(s.path > segment.path and s.whole for s in self._segments.values()):
            return
        self._delete(segment)

    def _delete(self, segment: _Segment) -> None:
        if segment is self._active:
            self._swap(-1, None)
        segment.path.unlink(missing_ok=True)
        del self._segments[segment.path]
        self.bytes -= segment.whole

    def sync(self) -> None:
        """What has been appended so far survives a power cut. Raises OSError. From any thread."""
        with self._lock:
            dirty = [segment for segment in list(self._segments.values()) if segment.dirty]
            for segment in dirty:
                segment.dirty = False
        for path in [segment.path for segment in dirty] + ([self._folder] if dirty else []):
            try:
                fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            except FileNotFoundError:  # not needed any more
                continue
            try:
                os.fsync(fd)
            finally:
                os.close(fd)

    def close(self) -> None:
        """Nothing is open any more; the files stay."""
        self._swap(-1, None)


def _head(items: list[Found | Damage], k: int) -> Head | None:
    item = items[k] if 0 <= k < len(items) else None
    return item.head if isinstance(item, Found) else None


def _missing(before: Head | None, after: Head | None, known: set[int]) -> int:
    """How many frames lay between two records, of those that are nowhere else; at least the one that was seen."""
    if before is None or after is None or after.seq <= before.seq:
        return 1
    return max(1, sum(seq not in known for seq in range(before.seq + 1, after.seq)))
