"""Commands side by side, none of which outlives whoever started them, nor does anything that they have started."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import IO

_PATIENCE_S = 20.0  # for tests to stop the servers that they have started
_TICK_S = 0.05


class Parts:
    """A context; each part is a process group of its own."""

    def __init__(self, folder: Path) -> None:
        """folder: where they run."""
        self._folder = folder
        self._started: list[subprocess.Popen[bytes]] = []

    def start(self, command: tuple[str, ...], out: IO[str] | None = None) -> subprocess.Popen[bytes]:
        """out: where it says what it says; None: where we do."""
        errors = None if out is None else subprocess.STDOUT
        part = subprocess.Popen(
            command, cwd=self._folder, stdin=subprocess.DEVNULL, stdout=out, stderr=errors, process_group=0
        )
        self._started.append(part)
        return part

    def __enter__(self) -> Parts:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Ends those that still run: as by Ctrl-C, and what is left of them after a while by SIGKILL."""
        running = [part for part in self._started if part.poll() is None]
        try:
            for part in running:
                os.killpg(part.pid, signal.SIGINT)
            until_s = time.monotonic() + _PATIENCE_S
            while not all(map(_has_ended, running)) and time.monotonic() < until_s:
                time.sleep(_TICK_S)
        finally:
            for part in running:
                os.killpg(part.pid, signal.SIGKILL)
                part.wait()


def _has_ended(part: subprocess.Popen[bytes]) -> bool:
    """It is not reaped: its number is its group's, and must not become another's before the group is killed."""
    return os.waitid(os.P_PID, part.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
