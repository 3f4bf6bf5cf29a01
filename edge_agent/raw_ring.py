"""The last seconds of what the sensors sent, as it came: for whoever asks afterwards why a run went as it did.

Files in a folder in memory (systemd's runtime directory is one): what is in them outlives an agent that is killed, and
another program reads them without asking anybody. They hold a bounded number of bytes and of seconds, cost one copy of
each message, and never end a run.

A file is `MAGIC` and records: kind, number of the stream, arrival ns, length, payload. A stream's record (JSON) stands
in each file before its first message, so that every file can be read alone.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import struct
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from splitslam.errors import InputError
from splitslam.logs import fields

if TYPE_CHECKING:
    from edge_agent.config import RawRingConfig

_log = logging.getLogger(__name__)

MAGIC = b"splitslam raw 1\n"
_HEAD = struct.Struct("<cHqI")
_STREAM, _MESSAGE = b"S", b"M"
_FILES = 16  # in a full ring
_MOST_FILES = 64  # where small ones were left behind, by restarts or a folder that failed
_AGAIN_S = 5.0
_STEP_BACK_NS = 1_000_000_000
_MAX_PAYLOAD = 64 * 2**20


@dataclass(frozen=True, slots=True)
class RawStream:
    """One topic of a source. encoding: ros1 or cdr. definition: the type's, in the language that `format` says."""

    topic: str
    msgtype: str
    encoding: str
    definition: str = ""
    format: str = "msg"  # or idl
    digest: str = ""


@dataclass(slots=True)
class _File:
    path: Path
    size: int
    newest_ns: int


class RawRing:
    """Written by the source's thread. Raises InputError when the folder cannot be made."""

    def __init__(self, folder: Path, settings: RawRingConfig) -> None:
        self._folder, self._settings = folder, settings
        self._numbers: dict[RawStream, int] = {}
        self._named: set[int] = set()  # streams that the open file knows
        self._open: int | None = None
        self._failed, self._again_s = False, 0.0
        try:
            folder.mkdir(mode=0o750, parents=True, exist_ok=True)
            old = sorted(folder.glob("*.raw"))  # an agent's before: what it saw last is what one wants to know
            self._files = deque(_File(path, path.stat().st_size, -(2**63)) for path in old)
        except OSError as error:
            raise InputError(
                f"raw_ring.dir {folder}: expected a directory that can be written ({error.strerror})"
            ) from None
        self._next = int(old[-1].stem) + 1 if old and old[-1].stem.isdecimal() else 1

    def add(self, stream: RawStream, arrival_ns: int, raw: bytes | memoryview) -> None:
        """Keeps a message. A folder that fails is said once, and tried again after some seconds."""
        if self._failed and time.monotonic() < self._again_s:
            return
        try:
            self._add(stream, arrival_ns, raw)
            self._failed = False
        except OSError as error:
            if not self._failed:
                _log.error("raw messages not kept", extra=fields(detail=str(error)))
            self._failed = True
            self._end_file()
            self._again_s = time.monotonic() + _AGAIN_S

    def _add(self, stream: RawStream, arrival_ns: int, raw: bytes | memoryview) -> None:
        number = self._numbers.setdefault(stream, len(self._numbers))
        if self._open is None or self._files[-1].size + len(raw) > self._settings.max_bytes // _FILES:
            self._begin_file(len(raw))
        assert self._open is not None
        if number not in self._named:
            self._put(_STREAM, number, 0, json.dumps(asdict(stream)).encode())
            self._named.add(number)
        self._put(_MESSAGE, number, arrival_ns, raw)
        file = self._files[-1]
        file.newest_ns = max(file.newest_ns, arrival_ns)

    def _put(self, kind: bytes, number: int, arrival_ns: int, payload: bytes | memoryview) -> None:
        assert self._open is not None
        size = _HEAD.size + len(payload)
        head = _HEAD.pack(kind, number, arrival_ns, len(payload))
        if os.writev(self._open, (head, payload)) < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._files[-1].size += size

    def _begin_file(self, needed: int) -> None:
        self._end_file()
        self._make_room(needed)
        file = _File(self._folder / f"{self._next:09d}.raw", len(MAGIC), -(2**63))
        self._next += 1
        self._open = os.open(file.path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o640)
        self._files.append(file)
        self._named.clear()
        os.write(self._open, MAGIC)

    def _make_room(self, needed: int) -> None:
        """Before a new file: the oldest go until it fits, and those that are too old anyway."""
        limit = self._settings.max_bytes - max(needed, self._settings.max_bytes // _FILES)
        newest_ns = self._files[-1].newest_ns if self._files else 0
        too_old_ns = newest_ns - int(self._settings.seconds * 1e9)
        while self._files and (
            sum(file.size for file in self._files) > limit
            or len(self._files) >= _MOST_FILES
            or -(2**63) < self._files[0].newest_ns < too_old_ns
        ):
            self._files.popleft().path.unlink(missing_ok=True)

    def _end_file(self) -> None:
        if self._open is not None:
            os.close(self._open)
            self._open = None

    def close(self) -> None:
        """The files stay."""
        self._end_file()


def read_ring(folder: Path, seconds: float) -> Iterator[tuple[RawStream, int, bytes]]:
    """(stream, arrival ns, raw message) of the ring's last `seconds`, as they came; works while an agent writes.

    Where arrival goes back, another recording or clock begins, and what was before it is left out.
    """
    newest_ns = -(2**63)
    first = last = ("", 0)
    for last, _, arrival_ns, _ in _messages(folder):
        if arrival_ns < newest_ns - _STEP_BACK_NS:
            first, newest_ns = last, arrival_ns
        newest_ns = max(newest_ns, arrival_ns)
    first_ns = newest_ns - int(seconds * 1e9)
    for place, stream, arrival_ns, raw in _messages(folder):
        if place > last:  # came since
            return
        if place >= first and arrival_ns >= first_ns:
            yield stream, arrival_ns, raw


def _messages(folder: Path) -> Iterator[tuple[tuple[str, int], RawStream, int, bytes]]:
    """With the place of each: name of its file, number in it."""
    for path in sorted(folder.glob("*.raw")):
        try:
            file = path.open("rb")
        except FileNotFoundError:  # the agent needed its room
            continue
        with file:
            for number, message in enumerate(_messages_of(file)):
                yield (path.name, number), *message


def _messages_of(file: BinaryIO) -> Iterator[tuple[RawStream, int, bytes]]:
    """Up to the file's end, or to where it is torn: an agent that was killed leaves half a record."""
    streams: dict[int, RawStream] = {}
    if file.read(len(MAGIC)) != MAGIC:
        return
    while len(head := file.read(_HEAD.size)) == _HEAD.size:
        kind, number, arrival_ns, length = _HEAD.unpack(head)
        if length > _MAX_PAYLOAD or len(payload := file.read(length)) < length:
            return
        if kind == _STREAM:
            streams[number] = RawStream(**json.loads(payload))
        elif kind == _MESSAGE and number in streams:
            yield streams[number], arrival_ns, payload
        else:
            return
