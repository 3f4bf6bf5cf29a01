"""Processes as /proc has them: what somebody has started, and CPU time."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

_TICKS_HZ = os.sysconf("SC_CLK_TCK")


def tree(pid: int) -> Iterator[tuple[int, str]]:
    """A process and all that it has started, each with its command line."""
    with suppress(OSError):
        yield pid, Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in (task / "children").read_text().split():
                yield from tree(int(child))


def cpu_s(pids: Iterable[int]) -> float:
    """User and system time of processes so far; of those that have ended nothing."""
    return sum(map(_one_s, pids))


def _one_s(pid: int) -> float:
    with suppress(OSError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS_HZ
    return 0.0


def threads_s(pids: Iterable[int]) -> dict[tuple[int, str], float]:
    """CPU time so far of every thread of processes, by its id and name."""
    found = {}
    for pid in pids:
        with suppress(OSError):
            for task in Path(f"/proc/{pid}/task").iterdir():
                with suppress(OSError):
                    head, _, tail = (task / "stat").read_text().rpartition(")")
                    fields = tail.split()
                    found[int(task.name), head.partition("(")[2]] = (int(fields[11]) + int(fields[12])) / _TICKS_HZ
    return found
