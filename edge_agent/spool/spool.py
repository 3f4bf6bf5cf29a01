"""The frames of one run on disk, for an outbox that must go on when the disk does not.

No method raises for what a disk does: a frame that cannot be written stays where it is, one that cannot be read is
gone, and either is counted by kind and logged once until it works again.
"""

from __future__ import annotations

import errno
import logging
import os
import threading
import time
from collections import Counter, OrderedDict
from pathlib import Path

from google.protobuf.message import DecodeError

from edge_agent.spool.record import Head
from edge_agent.spool.segment_log import DamagedError, Recovery, SegmentLog, Write
from splitslam.logs import fields
from splitslam.wire import session_pb2 as pb

_SEGMENT_BYTES = 512 * 1024  # 20 s of frames: a file is gone before the kernel would write it out by itself (30 s)
_LIVE_SHARE = 0.75  # of the room, for frames; the rest lets files with little in them be copied together
_SYNC_EVERY_S = 1.0
_SYNC_OLDER_S = 2.0  # while connected, frames are durable and gone before
_KINDS = {
    errno.ENOSPC: "full",
    errno.EDQUOT: "full",
    errno.EFBIG: "full",
    errno.EROFS: "read_only",
    errno.EACCES: "permission",
    errno.EPERM: "permission",
}
_log = logging.getLogger(__name__)


def kind_of(error: OSError) -> str:
    """What a disk has: full, read_only, permission, or io for all else."""
    return _KINDS.get(error.errno or 0, "io")


class Spool:
    """One run's folder. Methods are for one thread at a time; what makes frames survive a power cut has its own.

    errors: what went wrong, by kind: full, read_only, permission, io; damaged (frames), torn (ends of files).
    """

    def __init__(self, folder: Path, max_bytes: int, write: Write = os.write) -> None:
        """Raises OSError when the folder cannot be read."""
        self.folder = folder
        self.errors: Counter[str] = Counter()
        self.max_bytes = max_bytes
        self._segment_bytes = min(_SEGMENT_BYTES, max(max_bytes // 8, 1))
        self._log = SegmentLog(folder, self._segment_bytes, write)
        self._failing = False
        self._written_s: OrderedDict[int, float] = OrderedDict()
        self._oldest_s: float | None = None  # when the oldest frame here was written
        self._closing = threading.Event()
        self.recovered: Recovery = self._log.recover()
        self.errors += Counter(damaged=self.recovered.damaged, torn=self.recovered.torn)
        self._written_s.update((head.seq, time.monotonic()) for head in self.recovered.heads)
        self._note_oldest()
        if self.recovered.damaged:
            _log.error("spooled frames damaged", extra=fields(folder=str(folder), frames=self.recovered.damaged))
        self._syncer = threading.Thread(target=self._keep_synced, name="spool-sync", daemon=True)
        self._syncer.start()

    def __len__(self) -> int:
        return len(self._log)

    def __contains__(self, seq: int) -> bool:
        return seq in self._log

    @property
    def bytes(self) -> int:
        """Bytes of the files."""
        return self._log.bytes

    @property
    def overfull(self) -> bool:
        """The frames take more than their room: some must go."""
        return self._log.live_bytes > _LIVE_SHARE * (self.max_bytes - 2 * self._segment_bytes)

    def put(self, frame: pb.Frame, durable_seq: int) -> bool:
        """Writes a frame; False when the disk does not take it. durable_seq: the service's."""
        body = frame.SerializeToString()
        head = Head(frame.seq, frame.stamp_ns, frame.dense, durable_seq, len(body))
        try:
            self._log.append(head, body)
        except OSError as error:
            self._failed(error, "frames stay in memory")
            return False
        self._written_s[frame.seq] = time.monotonic()
        self._note_oldest()
        if self._failing:
            self._failing = False
            _log.warning("spool takes frames again", extra=fields(folder=str(self.folder)))
        self._shrink()
        return True

    def _shrink(self) -> None:
        limit_bytes = self.max_bytes - self._segment_bytes
        if self._log.bytes > limit_bytes:
            try:
                self._log.shrink(limit_bytes)
            except OSError as error:
                self._failed(error, "files with little in them stay")

    def get(self, seq: int) -> pb.Frame | None:
        """A frame as it was written, or None when it is lost."""
        try:
            return pb.Frame.FromString(self._log.read(seq))
        except (DamagedError, DecodeError) as error:
            self.errors["damaged"] += 1
            _log.error("spooled frame damaged", extra=fields(folder=str(self.folder), seq=seq, detail=str(error)))
        except OSError as error:
            self._failed(error, f"frame {seq} cannot be read")
        return None

    def release(self, seq: int) -> None:
        """The service has the frame for good."""
        try:
            self._log.release(seq)
        except OSError as error:
            self._failed(error, "files that are not needed stay")
        self._forget(seq)

    def give_up(self, seq: int) -> None:
        """The frame had to go."""
        try:
            self._log.give_up(seq)
        except OSError as error:
            self._failed(error, "a lost frame may come back after a restart")
        self._forget(seq)

    def _forget(self, seq: int) -> None:
        self._written_s.pop(seq, None)
        self._note_oldest()

    def _note_oldest(self) -> None:
        self._oldest_s = next(iter(self._written_s.values()), None)

    def _failed(self, error: OSError, consequence: str) -> None:
        self.errors[kind_of(error)] += 1
        if not self._failing:
            said = fields(folder=str(self.folder), detail=error.strerror or str(error), consequence=consequence)
            _log.error("spool disk fails", extra=said)
        self._failing = True

    # --- power cuts -------------------------------------------------------------------------------------------

    def _keep_synced(self) -> None:
        while not self._closing.wait(_SYNC_EVERY_S):
            self.sync_if_old()

    def sync_if_old(self) -> None:
        """While frames become durable at the service within seconds, the disk's own medium is left in peace."""
        oldest_s = self._oldest_s
        if oldest_s is not None and time.monotonic() - oldest_s > _SYNC_OLDER_S:
            self.sync()

    def sync(self) -> None:
        """Everything here survives a power cut."""
        try:
            self._log.sync()
        except OSError as error:
            self._failed(error, "a power cut would cost frames")

    def close(self) -> None:
        """The files stay, for the next start."""
        self._closing.set()
        self._syncer.join()
        if len(self._log):
            self.sync()
        self._log.close()
