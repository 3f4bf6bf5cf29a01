"""What has happened between two readings of an endpoint, a line each."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace

from splitslam.top.endpoint import Endpoint
from splitslam.top.page import Span
from splitslam.top.rows import EDGE, MAP, state_of

GRAVE, LIGHT, GOOD = "grave", "light", "good"


@dataclass(frozen=True, slots=True)
class Event:
    """who: the endpoint. weight: GRAVE, LIGHT or GOOD. count: how often."""

    who: str
    what: str
    weight: str
    count: int = 1

    @property
    def text(self) -> str:
        return self.what if self.count == 1 else f"{self.what} × {self.count}"


@dataclass(frozen=True, slots=True)
class _Counter:
    """A counter whose every increase is an event; {of}: the value of `label`."""

    name: str
    label: str
    what: str
    weight: str = LIGHT


_COUNTERS = (
    _Counter(f"{EDGE}dropped_total", "reason", "lost: {of}", GRAVE),
    _Counter(f"{EDGE}outages_total", "", "no answers: on its own", GRAVE),
    _Counter(f"{EDGE}reconnects_total", "cause", "stream broke: {of}"),
    _Counter(f"{EDGE}spool_errors_total", "kind", "disk of the spool: {of}", GRAVE),
    _Counter(f"{EDGE}imu_gaps_total", "", "IMU silent for a while"),
    _Counter(f"{EDGE}imu_resets_total", "", "IMU node begun anew", GRAVE),
    _Counter(f"{EDGE}clock_steps_total", "stream", "clock has stepped: {of}"),
    _Counter(f"{EDGE}deskew_troubles_total", "cause", "deskew without its logic: {of}"),
    _Counter(f"{EDGE}corrections_total", "cause", "map corrected: {of}", GOOD),
    _Counter(f"{MAP}worker_restarts_total", "", "a worker died and was started again", GRAVE),
    _Counter(f"{MAP}rejected_total", "reason", "frame rejected: {of}", GRAVE),
    _Counter(f"{MAP}refused_total", "reason", "robot refused: {of}"),
    _Counter(f"{MAP}fenced_total", "", "session taken over by another replica"),
    _Counter(f"{MAP}drained_total", "reason", "robot sent to another replica: {of}"),
)
_BAD_STATES = ("lost", "localising", "unanchored", "degenerate")


class Watch:
    """One endpoint's events from reading to reading."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._problem: str | None = None
        self._state = ""

    def events(self) -> list[Event]:
        """Since the last call, which was one reading ago."""
        endpoint = self._endpoint
        who, before, self._problem = endpoint.address, self._problem, endpoint.problem
        if endpoint.problem is not None:
            return [] if before == endpoint.problem else [Event(who, endpoint.problem, GRAVE)]
        step, events = endpoint.step, []
        assert step is not None
        if before is not None:
            events.append(Event(who, "answers again", GOOD))
        events += self._state_changed(step)
        return events if step.before is None else events + _counted(who, step)

    def _state_changed(self, step: Span) -> list[Event]:
        if not step.now.has(EDGE):
            return []
        before, self._state = self._state, state_of(step.now)
        if not before or before == self._state:
            return []
        weight = GOOD if self._state == "tracking" else LIGHT
        weight = GRAVE if self._state in _BAD_STATES else weight
        return [Event(self._endpoint.address, f"{before} → {self._state}", weight)]


def _counted(who: str, step: Span) -> list[Event]:
    return [
        Event(who, counter.what.format(of=of), counter.weight, round(count))
        for counter in _COUNTERS
        for of, count in step.increases(counter.name, counter.label).items()
        if count > 0
    ]


class Journal:
    """The last events, what happens again and again in one line that says how often."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._lines: OrderedDict[tuple[str, str], tuple[str, Event]] = OrderedDict()

    def add(self, clock: str, event: Event) -> None:
        """clock: when, for people."""
        key = event.who, event.what
        if key in self._lines:
            _, before = self._lines.pop(key)
            event = replace(event, count=before.count + event.count)
        self._lines[key] = clock, event
        while len(self._lines) > self._size:
            self._lines.popitem(last=False)

    @property
    def lines(self) -> tuple[tuple[str, Event], ...]:
        """(clock, event), the latest last."""
        return tuple(self._lines.values())
