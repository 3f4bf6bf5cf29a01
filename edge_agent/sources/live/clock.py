"""From the sensors' clocks to the one time of a run.

A run's time is that of a reference: GPS or PTP, when the LiDAR (else the IMU) says that it is locked to it, otherwise
our own clock as it stood at the start. A sensor that shares the reference's time base keeps its stamps to the
nanosecond. Every other one is tied to it by when its messages come: the least time that one is late by is the sensor's
and the line's own delay, and what is more is the system's.

    t_run = t_sensor + lateness(sensor) - lateness(reference)            lateness = least of (arrival - t_sensor)

The run's time never steps. When a lock comes while the run goes on, its time base is taken as it then stands to the
run's time, by one constant, `common`; and sensors that share it are moved to that constant, slowly. When the lock goes,
the run's time goes on by our own clock, `ahead` of it as it was at last:

    t_run = t_locked + common                   t_run = t_host - ahead,  ahead = lateness(reference) - common

Arrivals are on the monotonic clock, so that setting the wall clock changes nothing. What a sensor's clock does by
itself (a step, a restart) is put right where recordings have it put right: edge_agent/sources/stream_clock.py.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

from edge_agent.live_settings import ClockChoice
from edge_agent.sources.live.sensor_clock import LOCKED, SensorClock, TimeBase
from splitslam.logs import fields

_log = logging.getLogger(__name__)

_PATIENCE_NS = 2_000_000_000  # with sensors that do not come, or not again
_FIX_LATE_NS = 1_000_000_000  # receivers send a fix within a second: more, or less than none, is another clock


class RunClock:
    """The one map from all clocks to the run's time, chosen when the sensors have settled, and again with each lock."""

    def __init__(self, choice: ClockChoice, apart_s: float, waits_for: Sequence[str]) -> None:
        """waits_for: names of the clocks that may be the reference, the best first."""
        self._choice, self._apart_ns = choice, round(apart_s * 1e9)
        self._waits_for = tuple(waits_for)
        self._reference: SensorClock | None = None
        self._base: TimeBase | None = None  # the reference's, when it was taken
        self._common_ns = 0  # what is added to stamps of this base
        self._ahead_ns = 0
        self._began_ns: int | None = None
        self._decided = False
        self._wrong: dict[str, str] = {}
        self.clocks: dict[str, SensorClock] = {}

    def clock(self, name: str) -> SensorClock:
        """The clock of that name; sensors in one housing share one."""
        if name not in self.clocks:
            self.clocks[name] = SensorClock(name, steady=name in self._waits_for)
        return self.clocks[name]

    def all(self) -> list[SensorClock]:
        """Every clock there is."""
        return list(self.clocks.values())

    @property
    def problems(self) -> list[str]:
        """What is wrong with the clocks, one line each, for people."""
        return list(self._wrong.values())

    def behind_s(self) -> dict[str, float]:
        """By how much each clock is behind ours, its messages' way included, s."""
        return {clock.name: clock.lateness.latest_ns * 1e-9 for clock in self.all() if clock.lateness.settled}

    # --- the start --------------------------------------------------------------------------------------------

    def ready(self, clock: SensorClock, now_ns: int) -> bool:
        """Whether stamps of this clock can be told in the run's time; until then its messages have to wait."""
        if clock.chosen:
            return True
        if not clock.lateness.settled and clock.lateness.waited_ns(now_ns) >= _PATIENCE_NS:
            clock.lateness.settle()  # it has fallen silent again
        if clock.lateness.settled and (self._decided or self._decide(now_ns)):
            self._choose(clock)
        return bool(clock.chosen)

    def _decide(self, now_ns: int) -> bool:
        """The reference, once all that it may be have settled, or have had their time."""
        if self._began_ns is None:
            self._began_ns = now_ns
        heard = self._heard()
        if len(heard) < len(self._waits_for) and now_ns - self._began_ns < _PATIENCE_NS:
            return False
        if (best := self._best(heard)) is not None:
            self._reference, self._base = best, best.base
        self._decided = True
        return True

    # --- while it goes on -------------------------------------------------------------------------------------

    def offset_ns(self, clock: SensorClock) -> int:
        """What to add to the clock's stamps, ns."""
        return clock.follow(self._wanted_ns(clock))

    def look_around(self) -> None:
        """Takes locks that have come, once it is known how they stand; called now and then."""
        self._ahead()
        if not any(clock.undecided for clock in self.all()):
            return
        best = self._best([clock for clock in self._heard() if clock.chosen])
        if best is not None and (best is not self._reference or best.undecided):
            self._take(best)
        for clock in self.all():
            if clock.undecided and clock.lateness.settled:
                self._choose(clock)

    def _take(self, best: SensorClock) -> None:
        """As reference, at the offset that it has; where its time base was the run's before, that one counts."""
        offset_ns = best.follow(None)
        if best.base is not self._base or abs(offset_ns - self._common_ns) > self._apart_ns:
            self._base, self._common_ns = best.base, offset_ns
        self._reference = best
        for clock in self.all():
            clock.undecided = clock.undecided or (bool(clock.chosen) and clock.locked)

    def _ahead(self) -> int:
        """By how much our own clock is ahead of the run's time; as it was at last when the reference's lock is gone."""
        reference = self._reference
        if reference is not None and reference.base is self._base and reference.lateness.settled:
            self._ahead_ns = reference.lateness.offset_ns - self._common_ns
        return self._ahead_ns

    def _wanted_ns(self, clock: SensorClock) -> int | None:
        if clock.chosen in LOCKED:
            return self._common_ns
        ahead_ns = self._ahead()
        return clock.lateness.offset_ns - ahead_ns if clock.lateness.settled else None

    # --- the choice -------------------------------------------------------------------------------------------

    def _heard(self) -> list[SensorClock]:
        return [clock for name in self._waits_for if (clock := self.clock(name)).lateness.settled]

    def _best(self, heard: Sequence[SensorClock]) -> SensorClock | None:
        if self._choice == "host":
            return None
        wanted = LOCKED if self._choice == "auto" else (TimeBase(self._choice),)
        return next((clock for base in wanted for clock in heard if clock.base is base), None)

    def _choose(self, clock: SensorClock) -> None:
        """Its own stamps where they are of the reference's time base and say so rightly, else when messages come."""
        reference, base = self._reference, clock.base
        apart_ns = clock.lateness.offset_ns - self._ahead() - self._common_ns
        chosen, wrong = "host", ""
        if clock.name == "gnss" and self._choice != "host" and -self._apart_ns <= apart_ns <= _FIX_LATE_NS:
            chosen = base.value  # UTC, and the run's time is too: late by the receiver's own work
        elif reference is not None and base is self._base:
            if abs(apart_ns) <= self._apart_ns:
                chosen = base.value
            else:
                wrong = f"{clock.name}: its {base.value} time is {apart_ns * 1e-9:+.3f} s behind {reference.name}'s"
        elif self._choice not in ("auto", "host") and base.value != self._choice:
            wrong = f"{clock.name}: not locked to {self._choice}, as clock: {self._choice} asks"
        self._say(clock, chosen, wrong)

    def _say(self, clock: SensorClock, chosen: str, wrong: str) -> None:
        clock.chosen, clock.undecided = chosen, False
        wanted_ns = self._wanted_ns(clock) or 0
        said = {"taken_from": chosen, "behind_s": round(clock.lateness.offset_ns * 1e-9, 4)}
        moves_s = round((wanted_ns - clock.follow(wanted_ns)) * 1e-9, 6)
        _log.warning("sensor clock chosen", extra=fields(sensor=clock.name, **said, moves_s=moves_s))
        self._wrong.pop(clock.name, None)
        if wrong:
            self._wrong[clock.name] = f"{wrong}; it is stamped when its messages come"
            _log.warning("sensor clocks disagree", extra=fields(detail=wrong))
