"""Loop verification outside the hot path: a small pool of processes.

The first of them comes with its worker: what it loads takes 0.1 s of CPU, which no robot on its way should miss.
"""

from __future__ import annotations

import gc
import logging
import multiprocessing
import os
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from map_service.loops import LoopJob, LoopResult, refused, stand_by, verify
from map_service.processes import cpu_ns, follow_parent
from splitslam.config import Model
from splitslam.logs import fields

_log = logging.getLogger(__name__)


class LoopPool:
    """A LoopVerifier; shared by the sessions of one worker."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None
        self._ended_ns = 0

    def start(self) -> None:
        """Has a process load what it needs, without waiting for it."""
        self._running().submit(stand_by)

    def submit(self, job: LoopJob) -> Future[LoopResult]:
        """The future of `verify(job)`. It never fails: a job whose process died is a rejected loop, "failed"."""
        job = replace(job, settings=_plain(job.settings))
        try:
            inner = self._running().submit(verify, job)
        except BrokenProcessPool:
            self._ended_ns = self.cpu_ns()
            self._pool = None
            inner = self._running().submit(verify, job)
        outer: Future[LoopResult] = Future()
        inner.add_done_callback(lambda done: outer.set_result(_result(job, done)))
        return outer

    def _running(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                self._workers,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=follow_parent,
                initargs=(os.getpid(),),
            )
        return self._pool

    def cpu_ns(self) -> int:
        """CPU time of the pool's processes so far."""
        processes = getattr(self._pool, "_processes", None) or {}  # the executor does not say its pids otherwise
        return self._ended_ns + sum(cpu_ns(pid) for pid in list(processes))

    def close(self) -> None:
        """Ends the processes, whatever they do, and frees the pool's semaphores: the worker exits without handlers."""
        if self._pool is None:
            return
        pool, self._pool = self._pool, None
        for process in list((getattr(pool, "_processes", None) or {}).values()):
            process.kill()
        pool.shutdown(wait=True, cancel_futures=True)
        del pool
        gc.collect()


def _plain(settings: Model) -> Any:
    """The same values without pydantic, which a fresh process would take longer to load than all it needs."""
    values = {name: getattr(settings, name) for name in type(settings).model_fields}
    return SimpleNamespace(**{name: _plain(v) if isinstance(v, Model) else v for name, v in values.items()})


def _result(job: LoopJob, done: Future[LoopResult]) -> LoopResult:
    if not done.cancelled() and done.exception() is None:
        return done.result()
    _log.error("loop verification failed", extra=fields(older=job.older, newer=job.newer))
    return refused(job, "failed")
