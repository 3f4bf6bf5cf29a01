"""What has gone wrong between two readings of an endpoint, a line each."""

from __future__ import annotations

from dataclasses import dataclass

from splitslam.top.endpoint import Endpoint
from splitslam.top.page import Span
from splitslam.top.rows import EDGE, MAP, state_of

GRAVE, LIGHT, GOOD = "grave", "light", "good"


@dataclass(frozen=True, slots=True)
class Event:
    """who: the endpoint. weight: GRAVE, LIGHT or GOOD."""

    who: str
    what: str
    weight: str


@dataclass(frozen=True, slots=True)
class _Counter:
    """A counter whose every increase is an event; {n}: by how much, {of}: the value of `label`."""

    name: str
    label: str
    what: str
    weight: str = LIGHT


_COUNTERS = (
    _Counter(f"{EDGE}dropped_total", "reason", "{n} dropped: {of}", GRAVE),
    _Counter(f"{EDGE}reconnects_total", "cause", "stream broke: {of}"),
    _Counter(f"{EDGE}outages_total", "", "no answers: by its own odometry", GRAVE),
    _Counter(f"{EDGE}spool_errors_total", "kind", "spool: {n} {of}", GRAVE),
    _Counter(f"{EDGE}clock_steps_total", "stream", "clock of {of} has stepped"),
    _Counter(f"{EDGE}deskew_troubles_total", "cause", "deskew: {n} {of}"),
    _Counter(f"{MAP}worker_restarts_total", "", "a worker died and was started again", GRAVE),
    _Counter(f"{MAP}rejected_total", "reason", "{n} frames rejected: {of}", GRAVE),
    _Counter(f"{MAP}refused_total", "reason", "a stream refused: {of}"),
    _Counter(f"{MAP}fenced_total", "", "a stream fenced: another replica has its session"),
    _Counter(f"{MAP}drained_total", "reason", "{n} robots sent to another replica: {of}"),
    _Counter(f"{MAP}corrections_total", "cause", "map corrected: {of}", GOOD),
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
        Event(who, counter.what.format(n=f"{count:.0f}", of=of), counter.weight)
        for counter in _COUNTERS
        for of, count in sorted(step.increases(counter.name, counter.label).items())
        if count > 0
    ]
