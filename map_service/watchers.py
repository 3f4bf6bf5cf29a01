"""Those who watch the sessions of this replica: who wants what, and what waits for whom."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from map_service.channel import Seen, Watch
from map_service.metrics import ServiceMetrics
from splitslam.wire import view_pb2

WAITING = 64  # views that wait for one watcher, 6 s of a robot at 10 Hz; beyond, the oldest are dropped


class Watcher:
    """One call of WatchScans. site_id: None: sessions of every site."""

    def __init__(self, robot_id: str, site_id: str | None) -> None:
        self.robot_id, self.site_id = robot_id, site_id
        self._waiting: deque[bytes] = deque()
        self._missed = 0
        self._lost = False
        self._some = asyncio.Event()

    def wants(self, seen: Seen) -> bool:
        robot_id = seen.session_id.partition("/")[0]
        return self.robot_id in ("", robot_id) and self.site_id in (None, seen.site_id)

    def put(self, body: bytes) -> bool:
        """False: the oldest one had to go."""
        self._waiting.append(body)
        self._some.set()
        if len(self._waiting) <= WAITING:
            return True
        self._waiting.popleft()
        self._missed, self._lost = self._missed + 1, True
        return False

    def caught_up(self) -> bool:
        """It had lost views and reads fast enough again; true once."""
        caught_up = self._lost and len(self._waiting) < WAITING // 2
        self._lost = self._lost and not caught_up
        return caught_up

    async def next(self, timeout_s: float) -> bytes | None:
        """The oldest view that waits; None: none has come in time."""
        try:
            await asyncio.wait_for(self._some.wait(), timeout_s)
        except TimeoutError:
            return None
        body = self._waiting.popleft()
        if not self._waiting:
            self._some.clear()
        if self._missed:  # two serialised messages in a row are one message with the fields of both
            body += view_pb2.WatchScansResponse(missed=self._missed).SerializeToString()
            self._missed = 0
        return body


class Watchers:
    """All of them. The workers are told by `tell` what is wanted, each time that this changes."""

    def __init__(self, metrics: ServiceMetrics) -> None:
        self._metrics = metrics
        self._watchers: list[Watcher] = []
        self.tell: Callable[[Watch], None] = lambda watch: None

    @property
    def count(self) -> int:
        return len(self._watchers)

    @property
    def watch(self) -> Watch:
        """What all of them want together."""
        robots = {watcher.robot_id for watcher in self._watchers}
        return Watch(frozenset(robots - {""}), all_robots="" in robots)

    @contextmanager
    def watching(self, watcher: Watcher) -> Iterator[None]:
        """For as long as the block runs."""
        self._watchers.append(watcher)
        self._changed()
        try:
            yield
        finally:
            self._watchers.remove(watcher)
            self._changed()

    def _changed(self) -> None:
        self._metrics.viewers.set(len(self._watchers))
        self.all_anew()

    def all_anew(self) -> None:
        """Maps are told whole once more: somebody is new, or may have lost a correction with the views it has lost."""
        self.tell(self.watch)

    def pass_on(self, seen: Seen, answer_ms: float) -> None:
        """To those who want it."""
        body = b""
        for watcher in self._watchers:
            if watcher.wants(seen):
                body = body or seen.body + view_pb2.WatchScansResponse(answer_ms=answer_ms).SerializeToString()
                if not watcher.put(body):
                    self._metrics.views_missed.inc()
