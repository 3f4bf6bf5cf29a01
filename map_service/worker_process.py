"""One worker process as the front sees it: started by `spawn`, its messages taken, its streams fed."""

from __future__ import annotations

import asyncio
import logging
import math
import multiprocessing
import os
import socket
import time
from typing import Any

import grpc

from map_service.channel import Abort, Beat, Drained, Handed, Ready, Reply, RobotStanding, Seen, Watch
from map_service.config import ServiceConfig
from map_service.live_answers import LiveAnswers
from map_service.metrics import ServiceMetrics
from map_service.robot_gauges import RobotSeen
from map_service.streams import RobotStream
from map_service.watchers import Watchers
from map_service.worker import WorkerSpec, worker_main
from map_service.worker_link import WorkerLink
from splitslam.logs import fields

_LIVELY_S = 1.5

_log = logging.getLogger(__name__)


class WorkerProcess:
    """One worker: its process, its socket, the streams it serves."""

    def __init__(
        self,
        index: int,
        config: ServiceConfig,
        engine: str,
        metrics: ServiceMetrics,
        live: LiveAnswers,
        watchers: Watchers,
    ) -> None:
        """live: hears every answer. watchers: see what the worker shows."""
        self.index = index
        self.ready = asyncio.Event()
        self.streams: dict[int, RobotStream] = {}
        self.pinned: set[str] = set()
        self.drained = False
        self.beat_s = self.started_s = time.monotonic()
        self._config, self._metrics, self._live, self._watchers = config, metrics, live, watchers
        ours, theirs = socket.socketpair()
        self._sock = ours
        spec = WorkerSpec(index, config, engine, os.getpid())
        # never a daemon: it has children of its own
        self.process = multiprocessing.get_context("spawn").Process(target=worker_main, args=(spec, theirs))
        self.process.start()
        theirs.close()

    async def run(self) -> None:
        """Take its messages until it ends."""
        self._link = await WorkerLink.over(self._sock, self._take)
        try:
            await self._link.until_lost()
        finally:
            if self.ready.is_set():
                self._metrics.workers_ready.of().dec()
            self.ready.clear()
            self._link.close()

    async def send(self, message: Any) -> None:
        """Waits while the worker's queue is full; a worker that has died loses it (its streams are ended)."""
        await self._link.send(message)

    def watch(self, watch: Watch) -> None:
        """Tells a worker that is there whom somebody looks at. It never waits: such messages are few and small."""
        if self.ready.is_set():
            self._link.write(watch)

    def _take(self, message: Any) -> None:
        match message:
            case Reply():
                self._reply(message)
            case Abort():
                if stream := self.streams.get(message.stream):
                    stream.end(grpc.StatusCode[message.status], message.detail)
            case Beat():
                self.beat_s = time.monotonic()
                self._metrics.absorb(self.index, message, self.unanswered, self.delay_s)
                if self._metrics.robots is not None:
                    self._metrics.robots.update(self.index, [self._seen(robot) for robot in message.robots])
                self._credit(message.durable)
                self.pinned.difference_update(message.released)
                if message.busy_s > self._config.limits.stall_s:
                    self.kill(f"busy with one job for {message.busy_s:.0f} s")
            case Ready():
                self.beat_s = time.monotonic()
                self.ready.set()
                self._metrics.workers_ready.of().inc()
                self.watch(self._watchers.watch)
                _log.info("worker ready", extra=fields(worker=self.index, pid=message.pid))
            case Seen():
                stream = self.streams.get(message.stream or 0)
                self._watchers.pass_on(message, stream.took_s * 1e3 if stream else math.nan)
            case Handed(number, durable_seq):
                if stream := self.streams.get(number):
                    stream.handed(durable_seq)
            case Drained():
                self.drained = True
                self._credit(message.durable)

    def _reply(self, message: Reply) -> None:
        stream = self.streams.get(message.stream)
        if stream is None:
            return
        stream.opened = True
        if message.answer:
            self._live.tell(stream.number, stream.session_id, message.body)
            if (seconds := stream.put_answer(message.body)) is not None:
                self._metrics.answer_seconds.observe(seconds)
        else:
            stream.put(message.body)
        if message.last:
            stream.end()

    def _credit(self, durable: dict[int, int]) -> None:
        for number, durable_seq in durable.items():
            if stream := self.streams.get(number):
                stream.credit(durable_seq)

    @property
    def lively(self) -> bool:
        """It has given a sign of life lately, however long its present job takes."""
        return time.monotonic() - self.beat_s < _LIVELY_S

    @property
    def unanswered(self) -> int:
        return sum(stream.unanswered for stream in self.streams.values())

    @property
    def delay_s(self) -> float:
        """How long the oldest frame that waits for its answer has waited."""
        return max((stream.delay_s for stream in self.streams.values()), default=0.0)

    def _seen(self, robot: RobotStanding) -> RobotSeen:
        stream = None if robot.stream is None else self.streams.get(robot.stream)
        return RobotSeen(robot) if stream is None else RobotSeen(robot, stream.unanswered, stream.answered_s)

    def kill(self, why: str) -> None:
        _log.error("worker killed", extra=fields(worker=self.index, detail=why))
        self.process.kill()
