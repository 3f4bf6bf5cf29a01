"""Live sensors as a Source: one thread that waits for all ports at once."""

from __future__ import annotations

import os
import select
import threading
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_agent.sources.live.arrivals import ArrivalClock
from edge_agent.sources.live.clock import RunClock
from edge_agent.sources.live.feed import Feed, Reading
from edge_agent.sources.live.ports import Port
from edge_agent.sources.live.presence import Presence
from edge_agent.sources.live.raw_messages import RawMessages
from edge_agent.sources.source import Counts, Tap, TimedEvent
from edge_agent.sources.time_map import shifted
from splitslam.robot import Robot

_WAIT_S = 0.1  # at most, for the next packet
_TICK_S = 0.005  # what comes within one is handed on together
_QUIET_NS = 250_000_000  # then what a feed holds back for a next packet goes
_HELD_NS = 10_000_000_000  # for a clock to be known: it takes three seconds, unless nothing ever tells


@dataclass(slots=True)
class Input:
    """A port and what its bytes become; sensor: whose messages they are."""

    sensor: str
    port: Port
    feed: Feed
    came_ns: int = 0
    quiet: bool = True


class LiveSource:
    """A Source that reads ports. Messages wait until it is known how their clock's stamps come into the run's time.

    inputs: in the order in which they are read. `close` may be called from any thread, and closes the ports when
    `events` does not.
    """

    def __init__(
        self,
        robot: Robot,
        topics: dict[str, str],
        notes: list[str],
        beam_elevations_rad: NDArray[np.float32],
        inputs: Sequence[Input],
        arrivals: ArrivalClock,
        clocks: RunClock,
        presence: Presence,
        counts: Counts,
        dropped: Counter[str],
    ) -> None:
        self.robot, self.topics, self.notes = robot, topics, notes
        self.beam_elevations_rad = beam_elevations_rad
        self.counts, self.dropped = counts, dropped
        self.start_ns = self.end_ns = 0
        self.scan_count: int | None = None
        self.live_offset_ns: int | None = arrivals.offset_ns
        self.tap: Tap | None = None
        self.inputs, self.clocks, self.presence = tuple(inputs), clocks, presence
        self._arrivals = arrivals
        self._raw: RawMessages | None = None
        self._held: deque[tuple[int, int, Reading]] = deque()  # arrival, age of the clock then
        self._woken, self._wake = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._lock = threading.Lock()
        self._begun = self._ending = self._ended = False

    def events(self) -> Iterator[TimedEvent | None]:
        """See Source."""
        self._raw = None if self.tap is None else RawMessages(self.tap)
        self.presence.begin(self._arrivals.now_ns())
        with self._lock:
            self._begun = True
        try:
            while not self._ending:
                began_s = time.monotonic()
                ready = self._ready()
                for input in ready:
                    for data, arrival_ns in input.port.read():
                        yield from self._heard(input, input.feed.take(data, arrival_ns), arrival_ns)
                yield from self._look_around(ready)
                yield None
                self._sleep(_TICK_S - (time.monotonic() - began_s))
        finally:
            self._end()

    def packets(self) -> dict[tuple[str, str], float]:
        """Packets by sensor and what became of them."""
        sums: Counter[tuple[str, str]] = Counter()
        for input in self.inputs:
            for counts in (input.port.counts, input.feed.counts):
                for result, count in dict(counts).items():
                    sums[input.sensor, result] += count
        return dict(sums)

    def status(self) -> str:
        """See Source."""
        said = [self.presence.status(self._arrivals.now_ns()), *self.clocks.problems]
        return "; ".join(filter(None, said))

    def close(self) -> None:
        """See Source. The ports are closed by whoever iterates `events`, if anybody does."""
        with self._lock:
            self._ending = True
            if self._ended:
                return
            if self._begun:
                os.write(self._wake, b".")
                return
        self._end()

    # --- one round --------------------------------------------------------------------------------------------

    def _ready(self) -> list[Input]:
        """Ports with something to read, after waiting for one."""
        poll = select.poll()
        poll.register(self._woken, select.POLLIN)
        by_fd: dict[int, Input] = {}
        for input in self.inputs:
            if (fd := input.port.fileno) is not None:
                poll.register(fd, select.POLLOUT if input.port.writes else select.POLLIN)
                by_fd[fd] = input
        return [by_fd[fd] for fd, _ in poll.poll(_WAIT_S * 1000) if fd in by_fd]

    def _heard(self, input: Input, readings: Iterable[Reading], arrival_ns: int) -> Iterator[TimedEvent]:
        input.came_ns, input.quiet = arrival_ns, False
        for reading in readings:
            yield from self._pass(reading, arrival_ns)

    def _look_around(self, ready: Sequence[Input]) -> Iterator[TimedEvent]:
        """What happens because nothing happens. ready: had something, and may have more that came long ago."""
        now_ns = self._arrivals.now_ns()
        for input in self.inputs:
            if not input.quiet and input not in ready and now_ns - input.came_ns > _QUIET_NS:
                input.quiet = True
                for reading in input.feed.quiet():
                    yield from self._pass(reading, input.came_ns)
            input.port.tend()
        self.clocks.look_around()
        yield from self._release(now_ns)
        self.presence.look(now_ns)

    def _pass(self, reading: Reading, arrival_ns: int) -> Iterator[TimedEvent]:
        self.presence.heard(reading.sensor, arrival_ns)
        self._held.append((arrival_ns, reading.clock.age, reading))
        if self.clocks.ready(reading.clock, arrival_ns):
            yield from self._release(arrival_ns)

    def _release(self, now_ns: int) -> Iterator[TimedEvent]:
        """What has waited for its clock, and needs to no more."""
        held, self._held = self._held, deque()
        for came_ns, age, message in held:
            if age != message.clock.age:
                self.dropped["clock_changed"] += 1
            elif self.clocks.ready(message.clock, now_ns):
                yield self._emitted(came_ns, message)
            elif now_ns - came_ns > _HELD_NS:
                self.dropped["clock_unknown"] += 1
            else:
                self._held.append((came_ns, age, message))

    def _emitted(self, arrival_ns: int, reading: Reading) -> TimedEvent:
        offset_ns = self.clocks.offset_ns(reading.clock)
        event = shifted(reading.event, offset_ns)
        self.start_ns = min(self.start_ns or arrival_ns, arrival_ns)
        self.end_ns = max(self.end_ns, arrival_ns)
        if self._raw is not None:
            self._raw.put(arrival_ns, event, reading.packets, offset_ns)
        return arrival_ns, event

    # --- the end ----------------------------------------------------------------------------------------------

    def _sleep(self, seconds: float) -> None:
        """Unless it is closed meanwhile."""
        if seconds > 0:
            poll = select.poll()
            poll.register(self._woken, select.POLLIN)
            poll.poll(seconds * 1000)

    def _end(self) -> None:
        with self._lock:
            if self._ended:
                return
            self._ended = True
            os.close(self._woken)
            os.close(self._wake)
        for input in self.inputs:
            input.port.close()
