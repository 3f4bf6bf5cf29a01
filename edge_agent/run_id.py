"""The run's identity, kept in the state directory so that a restarted agent continues its session."""

from __future__ import annotations

import json
import logging
import os
import time
import uuid
from dataclasses import dataclass
from pathlib import Path

from splitslam.errors import InputError

MAX_GAP_S = 30.0
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_SAVE_EVERY_S = 1.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RunId:
    """`continued`: taken over from an agent that stopped at most MAX_GAP_S ago in the same boot."""

    value: str
    continued: bool


class RunState:
    """The file `run.json`: run_id, boot id and the time since boot (a step of the wall clock must not end a run)."""

    def __init__(self, state_dir: Path | None) -> None:
        self._path = state_dir / "run.json" if state_dir else None
        self._saved_s = float("-inf")

    def open(self) -> RunId:
        """The run to continue, or a new one. Raises InputError when the directory cannot be written."""
        resumable = self._resumable()
        run = RunId(resumable or str(uuid.uuid4()), resumable is not None)
        try:
            self._write(run)
        except OSError as error:
            raise InputError(f"state_dir: {error}; expected a directory that can be written") from None
        return run

    def _resumable(self) -> str | None:
        if self._path is None:
            return None
        try:
            saved = json.loads(self._path.read_text())
            gap_s = _since_boot_s() - float(saved["since_boot_s"])
            same_boot = saved["boot_id"] == _boot_id()
            run_id = str(uuid.UUID(saved["run_id"]))
        except (OSError, ValueError, KeyError, TypeError):  # none, or not ours: a new run begins
            return None
        return run_id if same_boot and 0.0 <= gap_s <= MAX_GAP_S else None

    def save(self, run: RunId) -> None:
        """Notes that the run is alive; cheap enough for every scan (writes at most once a second)."""
        if _since_boot_s() - self._saved_s < _SAVE_EVERY_S:
            return
        try:
            self._write(run)
        except OSError as error:  # a full disk must not end the run; a restart would then begin a new one
            _log.warning("run id not saved: %s", error)

    def _write(self, run: RunId) -> None:
        self._saved_s = _since_boot_s()
        if self._path is None:
            return
        text = json.dumps({"run_id": run.value, "boot_id": _boot_id(), "since_boot_s": self._saved_s})
        self._path.parent.mkdir(parents=True, exist_ok=True)
        temporary = self._path.with_suffix(".tmp")
        temporary.write_text(text)
        os.replace(temporary, self._path)

    def forget(self) -> None:
        """The run is finished: the next start is a new one."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def _boot_id() -> str:
    return _BOOT_ID.read_text().strip()


def _since_boot_s() -> float:
    return time.clock_gettime(time.CLOCK_BOOTTIME)
