"""Dense clouds on the robot's disk: a folder for each run, a file for each scan.

<run_id>/open             whose they are: splitslam.v1.UploadOpen, serialised
         00000042.new     of the dense frame 42, which may or may not have become a keyframe
         00000043.key     of a keyframe: the map service said so

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

from splitslam.logs import fields
from splitslam.wire import dense_pb2 as pb

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Kept:
    """One file. is_key: the scan is a keyframe's; inherited: an agent before wrote it. not_before_s: of the next offer,
    on the system's monotonic clock."""

    run_id: str
    seq: int
    size: int
    is_key: bool
    inherited: bool = False
    not_before_s: float = 0.0

    @property
    def name(self) -> str:
        return f"{self.seq:08d}.{'key' if self.is_key else 'new'}"


class CloudShelf:
    """At most `max_bytes` of clouds. Every method may be called from any thread.

    dropped: by reason; full: no room, disk: not written, damaged: cannot be read any more, and what others add.
    """

    def __init__(self, path: Path, max_bytes: int, own: pb.UploadOpen) -> None:
        """own: of the run that goes on now; what runs before have left is taken over."""
        self.dropped: Counter[str] = Counter()
        self._path, self._max_bytes, self._own = path, max_bytes, own
        self._lock = threading.Lock()
        self._files: dict[tuple[str, int], Kept] = {}  # by run and seq; the order in which they were written
        self._bytes = 0
        self._failing = False
        for folder in sorted(path.glob("????????-????-????-????-????????????"), key=lambda f: f.stat().st_mtime_ns):
            self._inherit(folder)

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
        self._tidy(folder.name)

    # --- what the run brings ----------------------------------------------------------------------------------

    def put(self, seq: int, cloud: bytes, *, is_key: bool = False) -> None:
        """Keeps the cloud of the own run's frame `seq`, of which the service has not said yet what it is."""
        file = Kept(self._own.run_id, seq, len(cloud), is_key)
        with self._lock:
            if len(cloud) > self._max_bytes:
                self.dropped["full"] += 1
                return
            while self._bytes + len(cloud) > self._max_bytes:
                self._drop(next(iter(self._files.values())), "full")
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
            elif not file.is_key:
                self._mark(file)

    def lose(self, reason: str) -> None:
        """One was not even made."""
        with self._lock:
            self.dropped[reason] += 1

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
        return len(self._files)

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
            if not (folder / "open").exists():
                folder.mkdir(parents=True, exist_ok=True)
                _write_whole(folder / "open", self._own.SerializeToString())
            _write_whole(folder / file.name, cloud)
        except OSError as error:
            self.dropped["disk"] += 1
            self._tell(error)
            return False
        self._failing = False
        return True

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
        try:
            (self._path / file.run_id / file.name).unlink(missing_ok=True)
        except OSError as error:
            self._tell(error)
        if file.run_id != self._own.run_id:
            self._tidy(file.run_id)

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
