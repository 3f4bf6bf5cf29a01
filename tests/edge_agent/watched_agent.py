"""`edge-agent run`, and on stdout what was compiled or read from the cache after its warm-up, and the CPU time at its
first frame."""

from __future__ import annotations

import gc
import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

gc.disable()  # as edge_agent.__main__ does
from numba.core.dispatcher import Dispatcher  # noqa: E402

from edge_agent import assembly, daemon  # noqa: E402
from edge_agent.config import AgentConfig  # noqa: E402
from edge_agent.sink import AgentSink  # noqa: E402
from splitslam.config import load  # noqa: E402

report: dict[str, Any] = {"first_frame_cpu_s": None}
warm_up, on_frame = assembly.warm_up, AgentSink.on_frame


def signatures() -> set[str]:
    """Of every kernel that is ready to be called."""
    kernels = [made for made in gc.get_objects() if isinstance(made, Dispatcher)]
    return {
        f"{kernel.py_func.__module__}.{kernel.py_func.__name__}{known}"
        for kernel in kernels
        for known in kernel.signatures
    }


def watched_warm_up(*arguments: Any) -> None:
    warm_up(*arguments)
    report["warm"] = signatures()


def watched_frame(self: AgentSink, *arguments: Any) -> Any:
    message = on_frame(self, *arguments)
    if report["first_frame_cpu_s"] is None:
        report["first_frame_cpu_s"] = time.process_time()
    return message


assembly.warm_up = watched_warm_up
AgentSink.on_frame = watched_frame  # pyright: ignore[reportAttributeAccessIssue]
daemon.run_agent(load(AgentConfig, Path(sys.argv[1]), "UNUSED"), threading.Event())
warm = report.pop("warm")
print(json.dumps({**report, "warm": len(warm), "late": sorted(signatures() - warm)}))
