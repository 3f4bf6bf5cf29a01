"""The run's identity, kept in the state directory so that a restarted agent continues its session."""

from __future__ import annotations

import json
import logging
import os
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from edge_agent.spool.spool import kind_of
from splitslam.errors import InputError
from splitslam.logs import fields

MAX_GAP_S = 30.0
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_SAVE_EVERY_S = 1.0
_FILE_BYTES = 256
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RunId:
    """`continued`: taken over from an agent that stopped at most MAX_GAP_S ago in the same boot.

    spooled: that agent had every frame on disk, so the spool says how far it came.
    """

    value: str
    continued: bool
    spooled: bool = False


class RunState:
    """The file `run.json`: run_id, boot id and the time since boot (a step of the wall clock must not end a run).

    It is written over in place, in one write: that needs no room on a full disk, and what a power cut leaves of it is
    of another boot.
    """

    def __init__(self, state_dir: Path | None) -> None:
        self._path = state_dir / "run.json" if state_dir else None
        self._saved_s = float("-inf")
        self._spooled = False

    def open(self, continues: Callable[[str], bool] = lambda run_id: True) -> RunId:
        """The run to continue, if it also `continues`, or a new one.

        Raises InputError when the directory cannot be written, unless its disk is full or read-only.
        """
        resumable = self._resumable()
        if resumable is None or not continues(resumable.value):
            resumable = RunId(str(uuid.uuid4()), continued=False)
        try:
            self._write(resumable, resumable.spooled)
        except OSError as error:
            if kind_of(error) not in ("full", "read_only"):
                raise InputError(f"state_dir: {error}; expected a directory that can be written") from None
            _log.error(
                "run id not saved: a restart begins a new run", extra=fields(run_id=resumable.value, detail=str(error))
            )
        return resumable

    def _resumable(self) -> RunId | None:
        if self._path is None:
            return None
        try:
            saved = json.loads(self._path.read_text())
            gap_s = _since_boot_s() - float(saved["since_boot_s"])
            same_boot = saved["boot_id"] == _boot_id()
            run_id = RunId(str(uuid.UUID(saved["run_id"])), True, bool(saved.get("spooled", False)))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):  # none, or not ours: a new run begins
            return None
        return run_id if same_boot and 0.0 <= gap_s <= MAX_GAP_S else None

    def save(self, run: RunId, spooled: bool = False) -> bool:
        """Notes that the run is alive, and whether all its frames are on disk; cheap enough for every scan.

        Writes when that changes, and at most once a second else. Returns whether it did.
        """
        if spooled == self._spooled and _since_boot_s() - self._saved_s < _SAVE_EVERY_S:
            return False
        try:
            self._write(run, spooled)
        except OSError as error:  # it must not end the run; a restart would then begin a new one
            _log.warning("run id not saved", extra=fields(run_id=run.value, detail=str(error)))
        return True

    def _write(self, run: RunId, spooled: bool) -> None:
        self._saved_s, self._spooled = _since_boot_s(), spooled
        if self._path is None:
            return
        saved = {"run_id": run.value, "boot_id": _boot_id(), "since_boot_s": self._saved_s, "spooled": spooled}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        fd = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            os.write(fd, json.dumps(saved).ljust(_FILE_BYTES).encode())
            os.ftruncate(fd, _FILE_BYTES)
        finally:
            os.close(fd)

    def forget(self) -> None:
        """The run is finished: the next start is a new one."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def _boot_id() -> str:
    return _BOOT_ID.read_text().strip()


def _since_boot_s() -> float:
    return time.clock_gettime(time.CLOCK_BOOTTIME)
