"""Counts what numba compiles: nothing, where the kernel cache is filled (beside the source or in $NUMBA_CACHE_DIR)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

from numba.core import event

_COMPILE = "numba:compile"


@dataclass(slots=True)
class KernelReport:
    """What a warm-up cost. compiled: functions that were not in the cache. seconds: wall time."""

    compiled: int = 0
    seconds: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@contextmanager
def counted() -> Iterator[KernelReport]:
    """Counts what is compiled inside the block; the report is complete after it."""
    report, began_s = KernelReport(), time.monotonic()
    with event.install_recorder(_COMPILE) as recorder:
        yield report
    report.compiled = sum(entry.is_start for _, entry in recorder.buffer)
    report.seconds = round(time.monotonic() - began_s, 3)
