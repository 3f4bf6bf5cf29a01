"""What each stage of the pipeline costs."""

from __future__ import annotations

import time


class StageClock:
    """CPU time of this thread and wall time, by stage."""

    def __init__(self) -> None:
        self.cpu_ms: dict[str, float] = {}
        self.wall_ms: dict[str, float] = {}
        self._start = self._last = (time.thread_time_ns(), time.perf_counter_ns())

    def lap(self, stage: str) -> None:
        """Adds the time since the lap before to `stage`."""
        now = (time.thread_time_ns(), time.perf_counter_ns())
        for times, a, b in zip((self.cpu_ms, self.wall_ms), self._last, now, strict=True):
            times[stage] = times.get(stage, 0.0) + (b - a) * 1e-6
        self._last = now

    def stop(self) -> None:
        """Sets `total`."""
        for times, a, b in zip((self.cpu_ms, self.wall_ms), self._start, self._last, strict=True):
            times["total"] = (b - a) * 1e-6
