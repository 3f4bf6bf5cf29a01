"""The front's worker processes: watched, restarted; sessions pinned to them."""

from __future__ import annotations

import asyncio
import logging
import time

import grpc

from map_service.channel import Close, DrainAll, Forget, HandOver, Open, Request, Watch
from map_service.config import ServiceConfig
from map_service.live_answers import LiveAnswers
from map_service.metrics import ServiceMetrics
from map_service.streams import RobotStream
from map_service.watchers import Watchers
from map_service.worker_process import WorkerProcess
from splitslam.logs import fields
from splitslam.wire import session_pb2 as pb

_RESTART_CAP_S = 5.0
_WATCH_S = 0.5
_HAND_OVER_S = 0.2  # a drained session waits no longer than this for its commit before the robot is sent on

_log = logging.getLogger(__name__)


class WorkerPool:
    """All workers. A session stays with its worker while that holds it in memory."""

    def __init__(self, config: ServiceConfig, engine: str, metrics: ServiceMetrics, live: LiveAnswers) -> None:
        """live: hears every answer."""
        self._config, self._engine, self._metrics, self._live = config, engine, metrics, live
        self._workers: list[WorkerProcess] = []
        self._tasks: list[asyncio.Task[None]] = []
        self._draining = False
        self._numbers = 0
        self.watchers = Watchers(metrics)
        self.watchers.tell = self._tell

    async def start(self) -> None:
        """Start all and wait until they are warm. Raises RuntimeError when one cannot start."""
        for index in range(self._config.worker_count):
            self._workers.append(self._new(index))
            self._tasks.append(asyncio.create_task(self._keep(index)))
        self._tasks.append(asyncio.create_task(self._watch()))
        await asyncio.gather(*(self._until_ready(worker) for worker in self._workers))

    def _new(self, index: int) -> WorkerProcess:
        return WorkerProcess(index, self._config, self._engine, self._metrics, self._live, self.watchers)

    def _tell(self, watch: Watch) -> None:
        for worker in self._workers:
            worker.watch(watch)

    @property
    def ready(self) -> bool:
        """Is there a worker that would take a session now?"""
        return any(worker.ready.is_set() for worker in self._workers)

    async def _until_ready(self, worker: WorkerProcess) -> None:
        while not worker.ready.is_set():
            if not worker.process.is_alive():
                raise RuntimeError(f"worker {worker.index} ended at its start, exit code {worker.process.exitcode}")
            await asyncio.sleep(0.02)

    async def _keep(self, index: int) -> None:
        """Run one worker, and the next one when it dies."""
        failures = 0
        while True:
            worker = self._workers[index]
            await worker.run()
            await asyncio.to_thread(worker.process.join)
            self._end_streams(worker)
            if self._draining:
                return
            self._metrics.restarts.inc()
            self._metrics.forget_worker(index)
            _log.error("worker died", extra=fields(worker=index, exit_code=worker.process.exitcode))
            failures = 0 if time.monotonic() - worker.started_s > 10 else failures + 1
            await asyncio.sleep(min(0.1 * 2**failures, _RESTART_CAP_S) if failures else 0)
            self._workers[index] = self._new(index)

    def _end_streams(self, worker: WorkerProcess) -> None:
        detail = "draining: reconnect" if self._draining else "the worker of this session has died: reconnect"
        for stream in worker.streams.values():
            stream.end(grpc.StatusCode.UNAVAILABLE, detail)

    async def _watch(self) -> None:
        """A worker that gives no sign of life is as good as dead. Time in which we were frozen is not its own."""
        looked_s = time.monotonic()
        while True:
            await asyncio.sleep(_WATCH_S)
            now_s = time.monotonic()
            frozen_s, looked_s = max(0.0, now_s - looked_s - 2 * _WATCH_S), now_s
            for worker in self._workers:
                worker.beat_s += frozen_s
                silent_s = now_s - worker.beat_s
                if worker.ready.is_set() and silent_s > self._config.limits.silent_s and not worker.drained:
                    worker.kill(f"silent for {silent_s:.1f} s")
                    worker.beat_s = time.monotonic()

    # -- streams ------------------------------------------------------------------------------------------------

    @property
    def streams(self) -> list[RobotStream]:
        return [stream for worker in self._workers for stream in worker.streams.values()]

    def _assign(self, session_id: str) -> WorkerProcess:
        for worker in self._workers:
            if session_id in worker.pinned and worker.process.is_alive():
                return worker
        for worker in self._workers:
            worker.pinned.discard(session_id)
        return min(self._workers, key=lambda w: (not w.ready.is_set(), len(w.streams), len(w.pinned), w.index))

    async def open(self, session_id: str, hello: bytes) -> tuple[WorkerProcess, RobotStream]:
        """Waits for a worker when all are being restarted."""
        while not (worker := self._assign(session_id)).ready.is_set():  # noqa: ASYNC110 - it may die before
            await asyncio.sleep(0.02)
        self._numbers += 1
        stream = RobotStream(self._numbers, session_id, self._config.limits.window_frames)
        worker.streams[stream.number] = stream
        worker.pinned.add(session_id)
        await worker.send(Open(stream.number, session_id, hello))
        return worker, stream

    async def request(self, worker: WorkerProcess, stream: RobotStream, body: bytes) -> None:
        await worker.send(Request(stream.number, body, time.process_time_ns()))

    async def close(self, worker: WorkerProcess, stream: RobotStream) -> None:
        worker.streams.pop(stream.number, None)
        await worker.send(Close(stream.number))

    async def forget(self, session_id: str) -> None:
        """The session was deleted."""
        for worker in self._workers:
            if session_id in worker.pinned:
                await worker.send(Forget(session_id))

    async def hand_over(self, stream: RobotStream, drain: pb.Drain) -> None:
        """Commits the stream's session, says `drain` to its robot and ends the stream."""
        worker = next((worker for worker in self._workers if stream.number in worker.streams), None)
        if worker is not None:
            stream.leave(drain)
            await worker.send(HandOver(stream.number))

    def holds(self, session_id: str) -> bool:
        """A worker has it in memory."""
        return any(session_id in worker.pinned and worker.process.is_alive() for worker in self._workers)

    @property
    def delay_s(self) -> float:
        """How long the oldest frame that waits for its answer has waited."""
        return max((worker.delay_s for worker in self._workers), default=0.0)

    def is_open(self, session_id: str) -> bool:
        return any(stream.session_id == session_id for stream in self.streams)

    # -- end ----------------------------------------------------------------------------------------------------

    async def drain(self) -> None:
        """Let every worker answer what is queued, commit and exit; kill those that take longer than drain_s.

        Robots hear that they shall leave when their session is handed over: the next replica then has nothing to
        repeat. A slow store does not keep them.
        """
        self._draining = True
        for worker in self._workers:
            if worker.ready.is_set():
                await worker.send(DrainAll())
            else:
                worker.process.kill()
        keepers = self._tasks[:-1]
        await asyncio.wait(keepers, timeout=_HAND_OVER_S)
        for stream in self.streams:
            stream.tell()
        await asyncio.wait(keepers, timeout=self._config.drain_s - _HAND_OVER_S)
        self.kill()
        await asyncio.wait(keepers, timeout=1.0)
        self._tasks[-1].cancel()

    def kill(self) -> None:
        """No process stays behind, and none is started again."""
        self._draining = True
        for worker in self._workers:
            if worker.process.is_alive():
                worker.kill("not drained in time")
