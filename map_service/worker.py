"""A worker process: one thread runs the pipelines of all sessions pinned to it.

Between two jobs it takes what has come from the socket; a reader of its own would have to be woken, and wake it, for
each frame. Threads besides: one that gives signs of life, one that commits. The worker ends with its front: the kernel
kills it, and the socket's end does if that should fail.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from map_service.channel import Beat, Close, DrainAll, Drained, Ready, WorkerEnd
from map_service.config import ServiceConfig
from map_service.engine import load_engine
from map_service.host import SessionHost
from map_service.processes import follow_parent, leave_out_of_collections, resident_bytes
from map_service.store import Store
from splitslam.logs import configure_logs, fields

BEAT_S = 0.5
_IDLE_S, _COMMITTING_S = 0.25, 0.02
_LOOK_AFTER_S = 0.02  # however much there is to do

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class WorkerSpec:
    """What a worker process is started with. engine: dotted path `module:Class`."""

    index: int
    config: ServiceConfig
    engine: str
    front_pid: int


def worker_main(spec: WorkerSpec, sock: socket.socket) -> None:
    """Entry point of the process."""
    follow_parent(spec.front_pid)
    configure_logs(spec.config.log.format, spec.config.log.level, replica=spec.config.name, worker=spec.index)
    code = 1
    try:
        engine = load_engine(spec.engine, spec.config.pipeline, spec.config.loop_workers)
        engine.warm_up()
        end = WorkerEnd(sock)
        store = Store(spec.config.store, spec.config.store_wait_s)
        host = SessionHost(spec.config, engine, store, end.send)
        leave_out_of_collections()
        Worker(host, end, spec.config.limits.worker_queue_messages).run()
        engine.close()
        code = 0
    except Exception:
        _log.exception("worker failed", extra=fields(worker=spec.index))
    logging.shutdown()
    os._exit(code)  # without the executors' exit handlers: they would wait for a loop job


class Worker:
    """The threads around a SessionHost."""

    def __init__(self, host: SessionHost, end: WorkerEnd, queue_messages: int) -> None:
        self._host, self._end = host, end
        self._queue: deque[Any] = deque()
        self._most_queued = queue_messages
        self._job_since_s: float | None = None

    def run(self) -> None:
        """Serve until drained. Raises OSError when the front is gone."""
        self._end.send(Ready(os.getpid()))
        threading.Thread(target=self._beat, daemon=True, name="beat").start()
        message: Any = None
        busy, looked_s = False, 0.0
        while not isinstance(message, DrainAll):
            message = self._next(wait=not busy)
            self._job_since_s = time.monotonic()
            busy = True
            if message is not None:
                self._host.handle(message)
            elif not self._host.care():
                busy = False
            if not busy or time.monotonic() - looked_s > _LOOK_AFTER_S:
                self._host.look_after()
                looked_s = time.monotonic()
            self._job_since_s = None
        self._host.drain()
        self._end.send(self._beat_now())
        self._end.send(Drained(self._host.sessions.durable()))

    def _next(self, *, wait: bool) -> Any | None:
        if len(self._queue) < self._most_queued:  # else the front keeps what comes, and reads no more from its robots
            wait_s = _COMMITTING_S if self._host.sessions.committing else _IDLE_S
            self._take_in(wait_s if wait and not self._queue else 0.0)
        return self._queue.popleft() if self._queue else None

    def _take_in(self, wait_s: float) -> None:
        """All that has come: a stream's Close is known before its Open, where both wait."""
        messages = self._end.receive(wait_s)
        if messages is None:  # the front is gone
            logging.shutdown()
            os._exit(1)
        self._host.closed.update(message.stream for message in messages if isinstance(message, Close))
        self._queue.extend(messages)

    def _beat(self) -> None:
        try:
            while True:
                time.sleep(BEAT_S)
                self._end.send(self._beat_now())
        except OSError:
            os._exit(1)

    def _beat_now(self) -> Beat:
        host, since_s = self._host, self._job_since_s
        counts, observations = host.tally.take()
        return Beat(
            counts=counts,
            observations=observations,
            busy_s=0.0 if since_s is None else time.monotonic() - since_s,
            durable=host.sessions.durable(),
            sessions=host.sessions.states(),
            released=host.sessions.take_released(),
            robots=host.sessions.robots() if host.config.metrics.per_robot else [],
            queue_messages=len(self._queue),
            undurable_frames=host.sessions.undurable_frames,
            cpu_s=host.cpu_ns() * 1e-9,
            resident_bytes=resident_bytes(),
        )
