"""Dense clouds on the robot's disk: a folder for each run, a file for each scan.

<run_id>/open             whose they are: splitslam.v1.UploadOpen, serialised
         00000042.new     of the dense frame 42, which may or may not have become a keyframe
         00000043.key     of a keyframe: the map service said so
         in_hand          scans that are neither here nor settled: of those a killed agent had, the service is asked

A file is written beside its name and renamed, so a killed agent leaves whole files; after a power cut the checksum
tells. What goes for want of room is the oldest; nothing goes without being counted.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
import threading
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from google.protobuf.message import DecodeError

from edge_agent.clouds.in_hand import InHand
from splitslam.logs import fields
from splitslam.wire import dense_pb2 as pb

_IN_HAND = "in_hand"
_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Kept:
    """One scan. is_key: it is a keyframe's; inherited: of an agent before. not_before_s: of the next offer, on the
    system's monotonic clock. gone_ns: None for one with a file; else the stamp of one that a killed agent had in hand.
    """

    run_id: str
    seq: int
    size: int
    is_key: bool
    inherited: bool = False
    not_before_s: float = 0.0
    gone_ns: int | None = None

    @property
    def name(self) -> str:
        return f"{self.seq:08d}.{'key' if self.is_key else 'new'}"


class CloudShelf:
    """At most `max_bytes` of clouds. Every method may be called from any thread.

    dropped: by reason; full: no room, disk: not written, damaged: cannot be read any more, killed: an agent before had
    it in hand, and what others add.
    """

    def __init__(self, path: Path, max_bytes: int, own: pb.UploadOpen) -> None:
        """own: of the run that goes on now; what runs before have left is taken over."""
        self.dropped: Counter[str] = Counter()
        self._path, self._max_bytes, self._own = path, max_bytes, own
        self._lock = threading.Lock()
        self._files: dict[tuple[str, int], Kept] = {}  # by run and seq; the order in which they were written
        self._bytes = 0
        self._failing = False
        self._in_hand: dict[str, InHand] = {}  # by run
        for folder in sorted(path.glob("????????-????-????-????-????????????"), key=lambda f: f.stat().st_mtime_ns):
            self._inherit(folder)
        self._mine = self._in_hand.setdefault(own.run_id, InHand(path / own.run_id / _IN_HAND))

    def _inherit(self, folder: Path) -> None:
        try:
            files = sorted(file for file in folder.iterdir() if file.is_file())
            for file in files:
                if file.suffix in (".new", ".key") and file.stem.isdecimal():
                    self._add(Kept(folder.name, int(file.stem), file.stat().st_size, file.suffix == ".key", True))
                elif file.suffix == ".part":
                    file.unlink(missing_ok=True)
        except OSError as error:  # such as another user's: what it costs is what lies there
            self._tell(error)
            return
        in_hand = self._in_hand[folder.name] = InHand(folder / _IN_HAND)
        for seq, stamp_ns in list(in_hand.stamps_ns.items()):
            if (folder.name, seq) in self._files:
                self._settle(folder.name, seq)
            else:
                self._add(Kept(folder.name, seq, 0, False, True, gone_ns=stamp_ns))
        self._tidy(folder.name)

    # --- what the run brings ----------------------------------------------------------------------------------

    def take(self, seq: int, stamp_ns: int) -> None:
        """There will be a cloud of the own run's frame `seq`, or a loss. Waits for nothing but a note of 16 bytes."""
        try:
            self._make_folder()
            self._mine.add(seq, stamp_ns)
        except OSError as error:
            self._tell(error)

    def put(self, seq: int, cloud: bytes, *, is_key: bool = False) -> None:
        """Keeps the cloud of the own run's frame `seq`, of which the service has not said yet what it is."""
        self._put(seq, cloud, is_key)
        self._settle(self._own.run_id, seq)

    def _put(self, seq: int, cloud: bytes, is_key: bool) -> None:
        file = Kept(self._own.run_id, seq, len(cloud), is_key)
        with self._lock:
            if len(cloud) > self._max_bytes:
                self.dropped["full"] += 1
                return
            while self._bytes + len(cloud) > self._max_bytes:
                self._drop(next(file for file in self._files.values() if file.gone_ns is None), "full")
            if self._write(file, cloud):
                self._add(file)

    def answered(self, seq: int, is_key: bool) -> None:
        """The service has said what frame `seq` of the own run is; its cloud need not be here."""
        with self._lock:
            file = self._files.get((self._own.run_id, seq))
            if file is None:
                return
            if not is_key:
                self._remove(file)
            elif file.gone_ns is not None:
                self._drop(file, "killed")
            elif not file.is_key:
                self._mark(file)

    def answered_without(self, seq: int, is_key: bool, reason: str) -> None:
        """The same of a frame whose cloud was not even made; reason: why."""
        if is_key:
            with self._lock:
                self.dropped[reason] += 1
        self._settle(self._own.run_id, seq)

    # --- what goes up -----------------------------------------------------------------------------------------

    def due(self, now_s: float) -> list[Kept]:
        """Of one run, those that may be offered now, oldest first: the own run before others."""
        with self._lock:
            files = list(self._files.values())
        own = self._own.run_id
        due = [f for f in files if f.not_before_s <= now_s and (f.is_key or f.inherited)]
        if not due:
            return []
        run_id = own if any(f.run_id == own for f in due) else due[0].run_id
        return sorted((f for f in due if f.run_id == run_id), key=lambda f: f.seq)

    def opening(self, run_id: str) -> pb.UploadOpen:
        """Whose clouds they are. A file that a power cut has emptied is made up for: the folder is this robot's."""
        if run_id != self._own.run_id:
            with contextlib.suppress(OSError, DecodeError):
                said = pb.UploadOpen.FromString((self._path / run_id / "open").read_bytes())
                if said.run_id == run_id:
                    return said
        return pb.UploadOpen(robot_id=self._own.robot_id, run_id=run_id, site_id=self._own.site_id)

    def read(self, file: Kept) -> bytes | None:
        """The cloud; None, and gone, when it is not here any more or cannot be read."""
        with self._lock:
            if (file.run_id, file.seq) not in self._files:
                return None
            try:
                return (self._path / file.run_id / file.name).read_bytes()
            except OSError:
                self._drop(file, "damaged")
                return None

    def done(self, file: Kept, lost: str = "") -> None:
        """The service has it, or does not want it; lost: why it is a loss."""
        with self._lock:
            if (file.run_id, file.seq) not in self._files:
                return
            if lost:
                self._drop(file, lost)
            else:
                self._remove(file)

    def give_up(self, run_id: str, reason: str) -> None:
        """Nothing of that run is wanted any more."""
        with self._lock:
            for file in [file for file in self._files.values() if file.run_id == run_id]:
                self._drop(file, reason)

    def has_keyframes(self, run_id: str) -> bool:
        """Whether the service has ever said of one of the run's that it is a keyframe."""
        with self._lock:
            return any(file.run_id == run_id and file.is_key for file in self._files.values())

    @property
    def waiting(self) -> int:
        """Clouds that are here."""
        with self._lock:
            return sum(file.gone_ns is None for file in self._files.values())

    @property
    def bytes(self) -> int:
        """Of the clouds that are here."""
        return self._bytes

    # --- under the lock ---------------------------------------------------------------------------------------

    def _add(self, file: Kept) -> None:
        self._files[file.run_id, file.seq] = file
        self._bytes += file.size

    def _write(self, file: Kept, cloud: bytes) -> bool:
        folder = self._path / file.run_id
        try:
            self._make_folder()
            _write_whole(folder / file.name, cloud)
        except OSError as error:
            self.dropped["disk"] += 1
            self._tell(error)
            return False
        self._failing = False
        return True

    def _make_folder(self) -> None:
        opening = self._path / self._own.run_id / "open"
        if not opening.exists():
            opening.parent.mkdir(parents=True, exist_ok=True)
            _write_whole(opening, self._own.SerializeToString())

    def _mark(self, file: Kept) -> None:
        before = self._path / file.run_id / file.name
        file.is_key = True
        try:
            before.rename(before.with_suffix(".key"))
        except OSError as error:
            self._drop(file, "disk")
            self._tell(error)

    def _drop(self, file: Kept, reason: str) -> None:
        self.dropped[reason] += 1
        _log.info("dense cloud lost", extra=fields(run_id=file.run_id, seq=file.seq, reason=reason))
        self._remove(file)

    def _remove(self, file: Kept) -> None:
        del self._files[file.run_id, file.seq]
        self._bytes -= file.size
        if file.gone_ns is not None:
            self._settle(file.run_id, file.seq)
        try:
            (self._path / file.run_id / file.name).unlink(missing_ok=True)
        except OSError as error:
            self._tell(error)
        if file.run_id != self._own.run_id:
            self._tidy(file.run_id)

    def _settle(self, run_id: str, seq: int) -> None:
        try:
            self._in_hand[run_id].settle(seq)
        except OSError as error:
            self._tell(error)

    def _tidy(self, run_id: str) -> None:
        """A run of before of which nothing is left."""
        if run_id != self._own.run_id and not any(known == run_id for known, _ in self._files):
            shutil.rmtree(self._path / run_id, ignore_errors=True)

    def _tell(self, error: OSError) -> None:
        """Once, until it works again."""
        if not self._failing:
            self._failing = True
            _log.error("dense clouds: disk fails", extra=fields(folder=str(self._path), detail=str(error)))


def _write_whole(path: Path, data: bytes) -> None:
    """All of it under its name, or nothing. Raises OSError."""
    part = path.with_suffix(".part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise
