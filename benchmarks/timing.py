"""CPU time of one call."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any


def best_cpu_ms(call: Callable[[], Any], repeats: int = 3) -> float:
    """CPU time of this thread, ms: the best of some, since other programs share the machine's caches."""
    times = []
    for _ in range(repeats):
        before = time.thread_time()
        call()
        times.append(time.thread_time() - before)
    return 1e3 * min(times)
