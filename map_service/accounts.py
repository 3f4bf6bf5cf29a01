"""What a session has cost and done: the service's part of report.json."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from map_service.engine import Pipeline
from map_service.series import Series
from splitslam.wire import session_pb2 as pb

EVERY_S = 5.0


class SessionAccounts:
    """Times and counts over one session, as far as this process and the store know them.

    CPU time is that of whole processes (front, worker, loop pool) from the session's first frame to its last
    answer: with one robot on the service it is what that robot costs.
    """

    def __init__(self, stored: str, own_cpu_ns: Callable[[], int]) -> None:
        self._cpu_ms, self._wall_ms = Series(), Series()
        self._own_cpu_ns = own_cpu_ns
        self._front_cpu_ns = 0
        self._frame_cpu_ns = self._frame_wall_ns = 0
        self._start_ns: int | None = None
        self._before_ms = float(json.loads(stored).get("cpu_ms", 0.0)) if stored else 0.0
        self._written_s = time.monotonic()
        self._edge: dict[str, Any] = {}
        self.backlog_frames = 0  # that wait on the robot, as it says

    def note_front(self, front_cpu_ns: int) -> None:
        """CPU time of the front as of the message at hand."""
        self._front_cpu_ns = front_cpu_ns

    def note_edge(self, report: pb.EdgeReport) -> None:
        """What the robot says it has lost."""
        self._edge = {
            "dropped": dict(sorted(report.dropped_by_reason.items())[:64]),
            "spool_frames": report.spool_frames,
            "spool_bytes": report.spool_bytes,
        }
        self.backlog_frames = report.spool_frames

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Around what is done for one frame, decoding included: thread CPU and wall time, summed until it is done."""
        if self._start_ns is None:
            self._start_ns = self._front_cpu_ns + self._own_cpu_ns()
        wall_ns, cpu_ns = time.perf_counter_ns(), time.thread_time_ns()
        yield
        self._frame_cpu_ns += time.thread_time_ns() - cpu_ns
        self._frame_wall_ns += time.perf_counter_ns() - wall_ns

    def frame_done(self) -> None:
        self._cpu_ms.add(self._frame_cpu_ns * 1e-6)
        self._wall_ms.add(self._frame_wall_ns * 1e-6)
        self._frame_cpu_ns = self._frame_wall_ns = 0

    def text_if_due(self, pipeline: Pipeline) -> str:
        """JSON for a commit now and then, else "": percentiles of a long session take their time."""
        return self.text(pipeline) if time.monotonic() - self._written_s >= EVERY_S else ""

    def text(self, pipeline: Pipeline) -> str:
        self._written_s = time.monotonic()
        values = pipeline.statistics()
        for name, times in (("map_ms", self._cpu_ms), ("map_wall_ms", self._wall_ms)):
            values[name] = {**values.get(name, {}), "total": times.summary()}
        spent_ns = 0 if self._start_ns is None else self._front_cpu_ns + self._own_cpu_ns() - self._start_ns
        values["cpu_ms"] = self._before_ms + spent_ns * 1e-6
        values["edge"] = self._edge
        return json.dumps(values)
