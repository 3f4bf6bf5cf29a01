"""Keeps one stream's stamps strictly increasing, whatever its clock does."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Generic

from edge_agent.sources.time_map import T, TimeMap, shifted
from splitslam.scan import ImuSamples, WheelSamples

JUMP_NS = 1_000_000_000  # a longer step ahead is believed only when the next message confirms it
_STEP_NS = 100_000_000  # smaller ones are jitter
_STEADY_NS, _STEADY_MESSAGES = 300_000_000, 3  # so much of a new timeline makes it one
_WAITED_NS = 2_000_000_000
_PACE, _JITTER_NS = 0.2, 200_000_000
_LATENCY_NS = 10_000_000_000  # of arrivals: in which the quickest one says how the clocks stand


@dataclass(frozen=True, slots=True)
class _Message(Generic[T]):
    """Stamps as the sensor said, first and last; when it came, None where nobody knows."""

    first_ns: int
    last_ns: int
    item: T
    arrival_ns: int | None


class StreamClock(Generic[T]):
    """Lets messages through in order, drops what is late or twice, and goes on over gaps and steps.

    A message far ahead, or behind, is held until the next ones tell. If they go back to where the stream was, its stamp
    was wrong: dropped as `time_jump` or `time_backwards`. If they follow it, and the time of arrival says that as much
    time has passed, there was a gap. If arrival says otherwise, the clock has stepped: from then on its stamps are put
    back by what keeps the quickest arrivals as quick as before.
    A step that is shorter than three messages of the stream, or less than a second ahead, is not told from lost
    messages: it costs what lies in it.
    Out of the same messages comes the same, on any machine: arrival is that of the recording when there is one.
    """

    def __init__(self, name: str, prefix: str, dropped: Counter[str], times: TimeMap) -> None:
        """name: of the stream, for people. prefix: of its reasons in `dropped`."""
        self._name, self._prefix, self._dropped, self._times = name, prefix, dropped, times
        self._offset_ns = 0  # what is added to stamps
        self._last_ns: int | None = None
        self._held: list[_Message[T]] = []
        self._quickest_ns: int | None = None  # arrival - stamp of the quickest message before the held ones
        self._arrivals: deque[tuple[int, int]] = deque()  # (arrival, arrival - stamp) of what has passed, newest last

    @property
    def offset_ns(self) -> int:
        """What is added to stamps."""
        return self._offset_ns

    def admit(self, first_ns: int, last_ns: int, item: T, arrival_ns: int | None = None) -> list[T]:
        """Messages that may pass now, in order. first_ns, last_ns: stamps in `item`; arrival_ns: on a steady clock."""
        message = _Message(first_ns, last_ns, item, arrival_ns)
        if not self._held:
            return self._look_at(message)
        if message.first_ns + self._offset_ns == self._last_ns or message.first_ns == self._held[-1].last_ns:
            self._drop("duplicate", item)
            return []
        if self._follows_the_old(message):
            self._drop_held()
            return self._look_at(message)
        if not self._follows_the_held(message):
            self._drop_held()
            return self._look_at(message)
        self._held.append(message)
        return self._judge()

    def admit_run(self, stamps_ns: Sequence[int], run: T, arrivals_ns: Sequence[int]) -> T:
        """`admit` of many messages at once, each of which `follows` the one before. run: all of them."""
        offset_ns = self._offset_ns
        self._last_ns = stamps_ns[-1] + offset_ns
        late_ns = [arrival - stamp - offset_ns for stamp, arrival in zip(stamps_ns, arrivals_ns, strict=True)]
        self._came(zip(arrivals_ns, late_ns, strict=True))
        return shifted(run, offset_ns)

    def _look_at(self, message: _Message[T]) -> list[T]:
        stamp_ns = message.first_ns + self._offset_ns
        if self._last_ns is not None:
            if stamp_ns == self._last_ns:
                self._drop("duplicate", message.item)
                return []
            if not 0 < stamp_ns - self._last_ns <= JUMP_NS:
                self._held = [message]
                self._quickest_ns = None
                if len(self._arrivals) >= _STEADY_MESSAGES:
                    self._quickest_ns = min(late_ns for _, late_ns in self._arrivals)
                return []
        return [self._pass(message)]

    def _follows_the_old(self, message: _Message[T]) -> bool:
        """Back where the stream was before it held something: by its stamp, and not later than it can be."""
        assert self._last_ns is not None
        ahead_ns = message.first_ns + self._offset_ns - self._last_ns
        held_behind = self._held[0].first_ns + self._offset_ns < self._last_ns
        passed_ns = self._passed_ns(message)
        return 0 < ahead_ns <= JUMP_NS + (passed_ns or 0) and (held_behind or message.first_ns < self._held[0].first_ns)

    def _follows_the_held(self, message: _Message[T]) -> bool:
        step_ns = message.first_ns - self._held[-1].last_ns
        return step_ns > 0 and (step_ns <= JUMP_NS or self._is_ahead())

    def _is_ahead(self) -> bool:
        assert self._last_ns is not None
        return self._held[0].first_ns + self._offset_ns > self._last_ns

    def _judge(self) -> list[T]:
        """A gap, a step, or not to be told yet."""
        change_ns = self._change_ns()
        if change_ns is None or abs(change_ns) < _STEP_NS or (self._is_ahead() and abs(change_ns) < JUMP_NS):
            # nothing says that it is no gap
            return self._let_go() if self._is_ahead() else self._wait()
        arrival_ns = self._held[-1].arrival_ns
        assert arrival_ns is not None
        shared_ns = self._times.known(change_ns, arrival_ns)
        if shared_ns is None and not self._is_steady():
            return self._wait()
        self._offset_ns += change_ns if shared_ns is None else shared_ns
        self._times.step(self._name, change_ns if shared_ns is None else shared_ns, arrival_ns)
        self._arrivals.clear()
        return self._let_go()

    def _wait(self) -> list[T]:
        """For what comes next; what has been waited for too long is a gap ahead, and lost behind."""
        if self._held[-1].last_ns - self._held[0].first_ns > _WAITED_NS:
            if self._is_ahead():
                return self._let_go()
            self._drop_first()
        return []

    def _change_ns(self) -> int | None:
        """By how much the clock seems to have stepped: what makes the held messages arrive as late as those before."""
        if self._quickest_ns is None or self._held[-1].arrival_ns is None or not self._keeps_time():
            return None
        late_ns = [m.arrival_ns - m.last_ns for m in self._held if m.arrival_ns is not None]
        return min(late_ns) - self._offset_ns - self._quickest_ns

    def _is_steady(self) -> bool:
        """The held messages are many enough, and took as long to come as they say."""
        first, last = self._held[0], self._held[-1]
        span_ns = last.last_ns - first.first_ns
        came_ns = (last.arrival_ns or 0) - (first.arrival_ns or 0)
        return len(self._held) >= _STEADY_MESSAGES and span_ns >= _STEADY_NS and came_ns >= span_ns // 2

    def _keeps_time(self) -> bool:
        """Did what came before arrive at the pace of its stamps? Not in a recording that was written in one go."""
        (first_ns, first_late_ns), (last_ns, last_late_ns) = self._arrivals[0], self._arrivals[-1]
        return abs(last_late_ns - first_late_ns) <= _PACE * (last_ns - first_ns) + _JITTER_NS

    def _passed_ns(self, message: _Message[T]) -> int | None:
        if message.arrival_ns is None or not self._arrivals:
            return None
        return max(message.arrival_ns - self._arrivals[-1][0], 0)

    def _let_go(self) -> list[T]:
        held, self._held = self._held, []
        passed: list[T] = []
        for message in held:
            if self._last_ns is None or message.first_ns + self._offset_ns > self._last_ns:
                passed.append(self._pass(message))
            else:
                self._drop("time_backwards", message.item)
        return passed

    def _pass(self, message: _Message[T]) -> T:
        self._last_ns = message.last_ns + self._offset_ns
        if (arrival_ns := message.arrival_ns) is not None:
            self._came([(arrival_ns, arrival_ns - self._last_ns)])
        return shifted(message.item, self._offset_ns)

    def _came(self, arrivals: Iterable[tuple[int, int]]) -> None:
        self._arrivals.extend(arrivals)
        newest_ns = self._arrivals[-1][0]
        while self._arrivals[0][0] < newest_ns - _LATENCY_NS:
            self._arrivals.popleft()

    def flush(self) -> list[T]:
        """At the end of input nothing can contradict a held message that is ahead."""
        if self._held and self._is_ahead():
            return self._let_go()
        self._drop_held()
        return []

    def pass_by(self, stamp_ns: int) -> None:
        """The stream has been waited for in vain: what it still has for the time up to here is of no use any more."""
        self._last_ns = stamp_ns if self._last_ns is None else max(self._last_ns, stamp_ns)

    def follows(self, first_ns: int) -> bool:
        """True when a message with this stamp passes at once."""
        return not self._held and (self._last_ns is None or 0 < first_ns + self._offset_ns - self._last_ns <= JUMP_NS)

    def _drop_held(self) -> None:
        while self._held:
            self._drop_first()

    def _drop_first(self) -> None:
        message = self._held.pop(0)
        ahead = self._last_ns is None or message.first_ns + self._offset_ns > self._last_ns
        self._drop("time_jump" if ahead else "time_backwards", message.item)

    def _drop(self, reason: str, item: T) -> None:
        self._dropped[self._prefix + reason] += len(item) if isinstance(item, ImuSamples | WheelSamples) else 1
