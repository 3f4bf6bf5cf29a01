"""Calls that follow sessions: how many there are, how often they ask the store, and how they end."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import grpc

from map_service.callers import Caller, Callers, DeniedError
from map_service.config import WatchConfig
from map_service.event_watch import EventWatch
from map_service.live_answers import LiveAnswer, LiveAnswers
from map_service.metrics import ServiceMetrics
from map_service.pose_watch import PoseWatch
from map_service.store import StoreError
from splitslam.errors import DataError
from splitslam.logs import fields
from splitslam.wire import pose_pb2 as pb

_THREADS = 2  # of their own: a store that is away must not use up those that others need
_ALIVE_S = 1.0
_TOGETHER_S = 0.02

T = TypeVar("T")
_log = logging.getLogger(__name__)


class TooManyWatchesError(Exception):
    """This replica serves as many as it may."""


class Watches:
    """Nothing here ever waits for a reader but the call that serves it."""

    def __init__(self, config: WatchConfig, callers: Callers, metrics: ServiceMetrics) -> None:
        self.callers, self.metrics, self.backlog = callers, metrics, config.backlog_scans
        self._config = config
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="watch")
        self._open: dict[asyncio.Event, str] = {}  # what wakes each of them -> its call
        self._draining = False

    async def poses(
        self, watch: PoseWatch, caller: Caller, live: LiveAnswers, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.WatchPosesResponse]:
        """Until the caller goes, all it asked for has ended, or the service shuts down. Raises TooManyWatchesError."""
        with self._counted("poses") as wake:

            def heard(answer: LiveAnswer) -> None:
                if watch.heard(answer):
                    wake.set()

            turn = _Turn(self._config.every_s)
            with live.heard_by(heard):
                while not watch.done:
                    await self._check(caller, context)
                    if turn.due and (found := await self._ask(watch.look, turn, context)) is not None:
                        for response in watch.take(found):
                            yield turn.spoken(response)
                        turn.again(found.more)
                    wake.clear()
                    for response in watch.take_live():
                        yield turn.spoken(response)
                    if turn.silent_s > _ALIVE_S:
                        yield turn.spoken(watch.alive())
                    await turn.wait(wake)

    async def events(
        self, watch: EventWatch, caller: Caller, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.EventsResponse]:
        """As `poses`."""
        with self._counted("events") as wake:
            turn = _Turn(self._config.every_s)
            while not watch.done:
                await self._check(caller, context)
                if turn.due and (found := await self._ask(watch.look, turn, context)) is not None:
                    for response in watch.take(found):
                        yield turn.spoken(response)
                    turn.again(found.more)
                if turn.silent_s > _ALIVE_S:
                    yield turn.spoken(watch.alive())
                await turn.wait(wake)

    async def _check(self, caller: Caller, context: grpc.aio.ServicerContext) -> None:
        """Ends a call when the service shuts down, so that it is made again elsewhere, or its caller was revoked."""
        if self._draining:
            await context.abort(grpc.StatusCode.UNAVAILABLE, "shutting down: call again")
        try:
            self.callers.check_revoked(caller)
        except DeniedError as denied:
            self.metrics.denied.inc(denied.reason)
            await context.abort(grpc.StatusCode.PERMISSION_DENIED, f"{denied.reason}: {denied.detail}")

    async def _ask(self, look: Callable[[], T], turn: _Turn, context: grpc.aio.ServicerContext) -> T | None:
        """None: the store is away, and will be asked again."""
        turn.asked()
        try:
            return await asyncio.get_running_loop().run_in_executor(self._threads, look)
        except StoreError as error:
            _log.warning("watch: the store is away", extra=fields(detail=str(error)))
            return None
        except DataError as error:
            await context.abort(grpc.StatusCode.DATA_LOSS, str(error))
        raise AssertionError  # abort raises

    @contextmanager
    def _counted(self, call: str) -> Iterator[asyncio.Event]:
        if len(self._open) >= self._config.most:
            raise TooManyWatchesError(f"{len(self._open)} calls follow sessions here, the limit is {self._config.most}")
        wake = asyncio.Event()
        self._open[wake] = call
        self._show(call)
        try:
            yield wake
        finally:
            del self._open[wake]
            self._show(call)

    def _show(self, call: str) -> None:
        self.metrics.watchers.set(sum(open_call == call for open_call in self._open.values()), call)

    def count_dropped(self, scans: int) -> None:
        """A reader is too slow for them."""
        self.metrics.watch_dropped.inc(by=scans)

    def drain(self) -> None:
        """All of them end: their callers go on at another replica."""
        self._draining = True
        for wake in self._open:
            wake.set()

    def close(self) -> None:
        self._threads.shutdown(wait=False, cancel_futures=True)


class _Turn:
    """When the store is to be asked next, and when something was said last."""

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._due_s = self._spoke_s = time.monotonic()

    @property
    def due(self) -> bool:
        return time.monotonic() >= self._due_s

    @property
    def silent_s(self) -> float:
        return time.monotonic() - self._spoke_s

    def asked(self) -> None:
        """The store is about to be asked."""
        self._due_s = time.monotonic() + self._every_s

    def again(self, more: bool) -> None:
        """Is there more to be had at once?"""
        if more:
            self._due_s = 0.0

    def spoken(self, response: T) -> T:
        self._spoke_s = time.monotonic()
        return response

    async def wait(self, wake: asyncio.Event) -> None:
        """For news, or until the store is to be asked again. Many robots' answers are told together."""
        try:
            await asyncio.wait_for(wake.wait(), max(self._due_s - time.monotonic(), 0.0))
            await asyncio.sleep(max(_TOGETHER_S - self.silent_s, 0.0))
        except TimeoutError:
            pass
