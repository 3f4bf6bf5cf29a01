"""What the processes of a map service take, as the kernel says: CPU time, and memory in which a page counts once."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from map_service.processes import cpu_ns
from splitslam.stack.process import descendants


@dataclass(frozen=True, slots=True)
class Usage:
    """cpu_s: user and system. pss_bytes: proportional set size, so that sums over processes count a page once."""

    cpu_s: float
    pss_bytes: int

    def __sub__(self, before: Usage) -> Usage:
        return Usage(self.cpu_s - before.cpu_s, self.pss_bytes - before.pss_bytes)


def usage(pid: int) -> Usage:
    """Of a process and all that it has started and that still run."""
    pids = (pid, *descendants(pid))
    return Usage(sum(map(cpu_ns, pids)) * 1e-9, sum(map(pss_bytes, pids)))


def pss_bytes(pid: int) -> int:
    """0 for a process that is gone (proc_pid_smaps(5), smaps_rollup)."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("Pss:")), 0)


def machine() -> dict[str, object]:
    """What the figures were measured on."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return {"cpus": len(os.sched_getaffinity(0)), "cpu": model, "load_before": round(os.getloadavg()[0], 2)}
