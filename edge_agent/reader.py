"""Reading and decoding in a thread of its own, and the bounded queue to the loop that processes."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from edge_agent.metrics import EdgeMetrics
from edge_agent.pulse import Pulse
from edge_agent.sources import TimedEvent
from splitslam.scan import Scan

_BATCH = 256  # events without a scan that are handed over together
_MAX_EVENTS = 100_000
_TICK_S = 0.005  # by the clock, what is due within one tick travels together
_CAUGHT_UP_S, _CATCH_UP_S = 0.25, 60.0
_IDLE_S = 0.1  # without events a live source's loop gets an empty batch, to look for answers
_END: Any = object()


class EventQueue:
    """Batches of events from one reader to one loop.

    At most `max_scans` scans wait: by the clock the oldest is dropped and counted, otherwise the reader waits.
    """

    def __init__(self, max_scans: int, may_drop: bool, metrics: EdgeMetrics) -> None:
        self._max_scans, self._may_drop, self._metrics = max_scans, may_drop, metrics
        self._batches: deque[list[TimedEvent]] = deque()
        self._scans_in: deque[int] = deque()  # each of them
        self._scans = self._events = 0
        self._changed = threading.Condition()
        self._ended = False
        self._closed = False
        self._error: BaseException | None = None

    @property
    def scans(self) -> int:
        """Scans that wait."""
        return self._scans

    def put(self, batch: list[TimedEvent], wait: bool = False) -> bool:
        """Adds a batch; False when nobody reads any more. wait: for room, where a scan would be dropped otherwise."""
        with self._changed:
            if wait or not self._may_drop:
                self._changed.wait_for(lambda: self._scans < self._max_scans or self._closed)
            scans = sum(isinstance(data, Scan) for _, data in batch)
            self._batches.append(batch)
            self._scans_in.append(scans)
            self._scans += scans
            self._events += len(batch)
            while self._may_drop and self._scans > self._max_scans:
                self._drop_oldest_scan()
            while self._may_drop and self._events > _MAX_EVENTS and len(self._batches) > 1:
                self._drop_oldest_batch()
            self._metrics.queue_events.set(self._events)
            self._changed.notify_all()
            return not self._closed

    def _drop_oldest_scan(self) -> None:
        which = next(i for i, scans in enumerate(self._scans_in) if scans)
        batch = self._batches[which]
        index = next(i for i, (_, data) in enumerate(batch) if isinstance(data, Scan))
        del batch[index]
        self._scans_in[which] -= 1
        self._scans -= 1
        self._events -= 1
        self._metrics.drop("queue_full")

    def _drop_oldest_batch(self) -> None:
        batch = self._next()
        self._metrics.drop("queue_full", len(batch))

    def _next(self) -> list[TimedEvent]:
        batch = self._batches.popleft()
        self._scans -= self._scans_in.popleft()
        self._events -= len(batch)
        return batch

    def end(self, error: BaseException | None = None) -> None:
        """No more batches; `error` is raised in the loop after the last one."""
        with self._changed:
            self._ended, self._error = True, error
            self._changed.notify_all()

    def close(self) -> None:
        """The loop wants no more: whoever waits goes on at once."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def batches(self) -> Iterator[list[TimedEvent]]:
        """The batches in order, until the end or `close`."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._batches or self._ended or self._closed)
                if self._closed:
                    return
                if not self._batches:
                    if self._error is not None:
                        raise self._error
                    return
                batch = self._next()
                self._metrics.queue_events.set(self._events)
                self._changed.notify_all()
            yield batch


class Reader(threading.Thread):
    """Pulls events (bag reading, packet decoding) and queues them; `cpu_s` is what that has cost so far.

    realtime: each event waits until as much time has passed as lies between it and the first in the recording.
    Otherwise batches end at scans and at fixed counts only, so that two runs see the same ones.
    live_offset_ns: of a live source (Source.live_offset_ns): nothing waits, and a batch is what came together. What has
    come while the agent started is handed over as fast as it is taken, and not dropped; from then on the newest counts.
    began_s: when the source's first message is due, on the monotonic clock; what is past when the reader gets there is
    skipped, and its scans are counted in `passed_scans`. first_ns: when that message came, known with the first event;
    None: with the first event.
    """

    def __init__(
        self,
        events: Iterable[TimedEvent | None],
        queue: EventQueue,
        realtime: bool,
        began_s: float | None = None,
        live_offset_ns: int | None = None,
        first_ns: Callable[[], int] | None = None,
    ) -> None:
        super().__init__(name="reader", daemon=True)
        self._first_ns = first_ns
        self._events, self._queue = events, queue
        self._paced = realtime and live_offset_ns is None
        self._stopped = threading.Event()
        self._began_s = began_s if self._paced else None
        self._origin_s = float("nan") if live_offset_ns is None else -live_offset_ns * 1e-9
        self._catching_up = live_offset_ns is not None
        self._start_s = 0.0
        self.cpu_s = 0.0
        self.pulse = Pulse("source")
        self.passed_scans = 0

    def due_s(self, arrival_ns: int) -> float:
        """When what the source says came at `arrival_ns` is or was due, on the monotonic clock; by the clock only."""
        return self._origin_s + arrival_ns * 1e-9

    def _origin_of(self, arrival_ns: int, now_s: float) -> float:
        """From the first event's arrival; a run that goes on has left out what came before it."""
        if self._began_s is None:
            return now_s - arrival_ns * 1e-9
        return self._began_s - (arrival_ns if self._first_ns is None else self._first_ns()) * 1e-9

    def stop(self) -> None:
        """Ends the reading and the loop at once."""
        self._stopped.set()
        self._queue.close()

    def close(self) -> None:
        """The same, and waits until the source is not used any more."""
        self.stop()
        if self.is_alive():
            self.join()

    def run(self) -> None:
        error: BaseException | None = None
        try:
            self._read()
        except BaseException as caught:  # it belongs to the loop, which waits for it
            error = caught
        self._queue.end(error)

    def _pulled(self) -> Iterator[TimedEvent | None]:
        events = iter(self._events)
        while True:
            with self.pulse.working():
                event = next(events, _END)
            if event is _END:
                return
            yield event

    def _is_late(self, arrival_ns: int) -> bool:
        """A live event has waited, or others before it still do, and there is time to catch up."""
        now_s = time.monotonic()
        behind = now_s - self.due_s(arrival_ns) > _CAUGHT_UP_S or self._queue.scans > 1
        return behind and now_s < self._start_s + _CATCH_UP_S

    def _read(self) -> None:
        self._start_s = time.monotonic()
        batch: list[TimedEvent] = []
        listening = self._began_s is None
        put_s = 0.0
        for event in self._pulled():
            self.cpu_s = time.thread_time()
            if event is None:  # nothing more has come; the loop looks for answers even if nothing ever does
                if batch or time.monotonic() - put_s > _IDLE_S:
                    put_s = time.monotonic()
                    if not self._queue.put(batch, self._catching_up):
                        return
                    batch = []
                if self._stopped.is_set():
                    return
                continue
            if self._paced:
                now_s = time.monotonic()
                if math.isnan(self._origin_s):
                    self._origin_s = self._origin_of(event[0], now_s)
                wait_s = self.due_s(event[0]) - now_s
                listening = listening or wait_s >= 0
                if not listening:
                    self.passed_scans += isinstance(event[1], Scan)
                    continue
                if wait_s > 0:
                    if batch and not self._queue.put(batch):
                        return
                    batch = []
                    self._stopped.wait(max(wait_s, _TICK_S))
            batch.append(event)
            if isinstance(event[1], Scan) or len(batch) >= _BATCH:
                self._catching_up = self._catching_up and self._is_late(event[0])
                if not self._queue.put(batch, self._catching_up):
                    return
                batch = []
            if self._stopped.is_set():
                return
        self._queue.put(batch)
        self.cpu_s = time.thread_time()
