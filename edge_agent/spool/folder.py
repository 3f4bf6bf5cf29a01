"""The spool's directory: a folder for each run that the map service may not have to its end.

lock                      held by the agent that uses the directory
<run_id>/hello            the run's Hello, serialised
         dropped.json     what the run has lost, by reason
         bye              the last seq, once the run has said Bye
         00000001.seg ... its frames
refused/<run_id>/         set aside: the service does not take it any more
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from google.protobuf.message import DecodeError

from edge_agent.spool.spool import Spool, kind_of
from splitslam.errors import InputError
from splitslam.logs import fields
from splitslam.wire import session_pb2 as pb

_REFUSED = "refused"
_SMALLEST_BYTES = 1 << 20
_log = logging.getLogger(__name__)


class RunFolder:
    """One run's folder and what lies in it besides frames."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._hello = b""
        self._dropped: dict[str, int] = {}

    @property
    def run_id(self) -> str:
        return self.path.name

    @property
    def hello(self) -> pb.Hello | None:
        """The run's Hello, None when it cannot be read."""
        try:
            return pb.Hello.FromString((self.path / "hello").read_bytes())
        except (OSError, DecodeError):
            return None

    def begin(self, hello: pb.Hello) -> None:
        """Makes the folder; when the disk does not let it, `note_dropped` tries again."""
        self._hello = hello.SerializeToString()
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            (self.path / "hello").write_bytes(self._hello)
            self._hello = b""
        except OSError as error:
            _log.info("spool file not written", extra=fields(file="hello", detail=str(error)))

    @property
    def dropped(self) -> dict[str, int]:
        """What the run had lost, by reason, when this was last noted."""
        try:
            noted = json.loads((self.path / "dropped.json").read_text())
            return {str(reason): int(count) for reason, count in noted.items()}
        except (OSError, ValueError, AttributeError, TypeError):
            return {}

    def note_dropped(self, dropped: Mapping[str, int]) -> None:
        """Keeps the counts for the agent that goes on with the run; nothing is written while they stay the same."""
        if self._hello:
            self.begin(pb.Hello.FromString(self._hello))
        if dropped == self._dropped:
            return
        self._dropped = dict(dropped)
        self._write("dropped.json", json.dumps(self._dropped))

    @property
    def said_bye(self) -> bool:
        """Whether the run was complete: a service that calls it finished has all of it."""
        return (self.path / "bye").exists()

    def say_bye(self, last_seq: int) -> None:
        """Bye is about to be said."""
        self._write("bye", str(last_seq))

    def _write(self, name: str, text: str) -> None:
        try:
            (self.path / name).write_text(text)
        except OSError as error:  # the frames matter more; spool.py tells of a disk that fails
            _log.info("spool file not written", extra=fields(file=name, detail=str(error)))

    @property
    def bytes(self) -> int:
        """Bytes of all files."""
        return sum(file.stat().st_size for file in self.path.glob("*") if file.is_file())

    def delete(self) -> None:
        """The service has all of it."""
        shutil.rmtree(self.path, ignore_errors=True)

    def set_aside(self) -> Path:
        """Nothing of it can be sent any more; returns where it lies now."""
        target = self.path.parent / _REFUSED / self.run_id
        try:
            target.parent.mkdir(exist_ok=True)
            os.replace(self.path, target)
        except OSError as error:
            _log.error("refused frames not set aside", extra=fields(run_id=self.run_id, detail=str(error)))
            return self.path
        self.path = target
        return target


class SpoolFolder:
    """All runs of one robot. At most `max_bytes` lie here; what is set aside goes first when room is short."""

    def __init__(self, path: Path, max_bytes: int) -> None:
        """Raises InputError when the directory cannot be used, or another agent uses it.

        A disk that is full or read-only is no mistake of the user's: the run begins without it.
        """
        self.path, self.max_bytes = path, max_bytes
        self._lock = -1
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(path / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            if kind_of(error) not in ("full", "read_only"):
                expected = "expected a directory that can be written"
                raise InputError(f"spool {path}: {error.strerror or error}; {expected}") from None
            said = fields(folder=str(path), detail=error.strerror, consequence="frames stay in memory")
            _log.error("spool disk fails", extra=said)
            return
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._lock)
            raise InputError(f"spool {path}: in use; expected a directory of its own for each agent") from None

    def run(self, run_id: str) -> RunFolder:
        return RunFolder(self.path / run_id)

    def continues(self, run_id: str, hello: pb.Hello) -> bool:
        """Can a run go on under this Hello? Not after its Bye, and not when its frames mean something else."""
        run = self.run(run_id)
        before = run.hello
        if before is None:
            return True  # no frame of it is here: what the service says decides
        same = before.robot_id == hello.robot_id and before.robot_file_yaml == hello.robot_file_yaml
        return same and before.beam_elevations_rad == hello.beam_elevations_rad and not run.said_bye

    def others(self, run_id: str) -> list[RunFolder]:
        """Runs before `run_id` that the service may not have to the end, oldest first; what is none is removed."""
        runs = []
        for path in self._folders():
            if path.name == run_id:
                continue
            run = RunFolder(path)
            if run.hello is None or not any(path.glob("*.seg")):
                run.delete()  # an agent that ended before its first frame
            else:
                runs.append(run)
        return sorted(runs, key=lambda run: (run.path / "hello").stat().st_mtime_ns)

    def _folders(self) -> list[Path]:
        """Those of runs, as a run is named."""
        return [path for path in self.path.glob("????????-????-????-????-????????????") if path.is_dir()]

    def open(self, run: RunFolder) -> Spool:
        """The run's frames, within the room that the other runs leave. Raises OSError."""
        set_aside = [RunFolder(path) for path in (self.path / _REFUSED).glob("*")]
        set_aside.sort(key=lambda refused: refused.path.stat().st_mtime)
        others = [RunFolder(path) for path in self._folders() if path.name != run.run_id]
        taken = sum(other.bytes for other in (*others, *set_aside))
        while set_aside and taken > self.max_bytes // 2:
            oldest = set_aside.pop(0)
            taken -= oldest.bytes
            _log.error("refused run deleted for want of room", extra=fields(run_id=oldest.run_id))
            oldest.delete()
        return Spool(run.path, max(self.max_bytes - taken, min(_SMALLEST_BYTES, self.max_bytes)))

    def close(self) -> None:
        """Another agent may use the directory."""
        if self._lock >= 0:
            os.close(self._lock)
