"""Watches an edge agent through its run: progress, notes, and how it ends."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splitslam.run.processes import Child, RunFailedError, how_it_ended, started

NAME = "edge-agent"
_STOP_S = 5.0
_TICK_S = 0.1
_KEPT_LINES = 60


@dataclass(frozen=True, slots=True)
class Watcher:
    """What is told about a run while it goes on.

    expected: how many scans there will be, None when unknown. scan: how many have been read and mapped.
    note: a line the agent has for the user. alive: called often; raises to end the run. dense: whole scans that have
    been sent after the last one, and those that have not.
    """

    expected: Callable[[int | None], None]
    scan: Callable[[int, int], None]
    note: Callable[[str], None]
    alive: Callable[[], None]
    dense: Callable[[int, int], None] = lambda sent, waiting: None


def run_agent(command: tuple[str, ...], config: Path, watcher: Watcher) -> None:
    """Run the agent to its end.

    Raises RunFailedError with its last line; the exit code is the agent's own when that line is for the user (2).
    """
    with started(NAME, (*command, "run", "--config", str(config)), _STOP_S) as child:
        notes = _Notes(watcher.note)
        while child.exit_code is None:
            watcher.alive()
            if line := child.next_line(_TICK_S):
                _take(line, watcher, notes)
        for line in child.remaining_lines():
            _take(line, watcher, notes)
        if child.exit_code != 0:
            raise _failure(child, notes)
        notes.release()


class _Notes:
    """Lines on stderr wait for the first scan: when there will be none, only the last one, the error, is shown."""

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._waiting: deque[str] | None = deque(maxlen=_KEPT_LINES)
        self.last = ""

    def add(self, text: str) -> None:
        if not text.strip():
            return
        if self.last:
            (self._show if self._waiting is None else self._waiting.append)(self.last)
        self.last = text

    def scans_flow(self) -> None:
        """Show what has waited, all but the last line: it may be the error."""
        for text in self._waiting or ():
            self._show(text)
        self._waiting = None

    def release(self) -> None:
        """No error: show all."""
        self.scans_flow()
        if self.last:
            self._show(self.last)


def _take(line: tuple[str, str], watcher: Watcher, notes: _Notes) -> None:
    kind, text = line
    if kind == "err":
        notes.add(text)
        return
    try:
        message: dict[str, Any] = json.loads(text)
        event = message["event"]
        if event == "start":
            watcher.expected(message["scans"])
        elif event == "scan":
            notes.scans_flow()
            watcher.scan(message["read"], message["mapped"])
        elif event == "dense":
            watcher.dense(message["sent"], message["waiting"])
    except (ValueError, TypeError, KeyError):
        notes.add(text)


def _failure(child: Child, notes: _Notes) -> RunFailedError:
    exit_code = child.exit_code or 0
    if exit_code == 2:
        return RunFailedError(notes.last, exit_code)
    notes.scans_flow()
    ended = how_it_ended(NAME, exit_code)
    return RunFailedError(f"{ended}: {notes.last}" if notes.last else ended)
