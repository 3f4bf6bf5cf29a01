"""Processes that die with their parent, and what they have cost."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
_TICK_NS = 1_000_000_000 // os.sysconf("SC_CLK_TCK")


def follow_parent(parent_pid: int) -> None:
    """Called first in a child: the kernel kills it when its parent dies, and Ctrl-C or a stop of the whole group
    is the parent's to handle."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent_pid:  # it died before the kernel was told
        os._exit(1)


def leave_out_of_collections() -> None:
    """Called once all is loaded: modules and compiled kernels, 200,000 objects, are there to stay.

    A full collection that looks at each of them stops an answer for 80 ms.
    """
    gc.collect()
    gc.freeze()


def resident_bytes() -> int:
    """Resident memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE_BYTES


def cpu_ns(pid: int) -> int:
    """User and system time of a process, 0 when it is gone (steps of the kernel's clock tick, 10 ms)."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0
    return (int(fields[11]) + int(fields[12])) * _TICK_NS
