"""From the sensors' clocks to the one time of a run.

A run's time is that of a reference: GPS or PTP, when the LiDAR (else the IMU) says that it is locked to it, otherwise
our own clock as it stood at the start. A sensor that shares the reference's time base keeps its stamps to the
nanosecond. Every other one is tied to it by when its messages come: the least time that one is late by is the sensor's
and the line's own delay, and what is more is the system's.

    t_run = t_sensor + lateness(sensor) - lateness(reference)            lateness = least of (arrival - t_sensor)

Arrivals are on the monotonic clock, so that setting the wall clock changes nothing. What a sensor's clock does by
itself (a step, a restart) is put right where recordings have it put right: edge_agent/sources/stream_clock.py.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from edge_agent.live_settings import ClockChoice
from splitslam.logs import fields

_log = logging.getLogger(__name__)

SETTLE_NS = 1_000_000_000  # of a sensor's first messages, before it is known how late they come
_PATIENCE_NS = 2_000_000_000  # with sensors that do not come, or not again
_BLOCK_NS = 1_000_000_000
_BLOCKS = 8
_SLEW = 200e-6  # crystals differ by up to 100 ppm; faster than that no offset moves, so that no stamp goes back
_OUTLIER_NS = 100_000_000  # a step of the sensor's clock, not a late message: the offset does not follow it
_STEPPED_BLOCKS = 3
_FIX_LATE_NS = 1_000_000_000  # receivers send a fix within a second: more, or less than none, is another clock


class TimeBase(StrEnum):
    """Whose time a sensor's stamps are in."""

    GPS = "gps"
    PTP = "ptp"
    OWN = "own"  # a clock that nobody sets, or that says that it is not locked
    NONE = "none"  # no clock: stamps are when the message came


class Lateness:
    """How late messages of one clock come at least, followed as two clocks drift apart. All in ns."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._least: deque[int] = deque(maxlen=_BLOCKS)  # of each block, newest last
        self._block_ns = 0  # arrival at which the newest block began
        self._moved_ns = 0
        self._offset = math.nan
        self._step_ns = 0  # of the sensor's clock so far, left to the stream's own clock
        self._off = 0  # blocks in a row that say another offset

    @property
    def settled(self) -> bool:
        """Enough has been heard to know it."""
        return not math.isnan(self._offset)

    @property
    def offset_ns(self) -> int:
        """The least lateness, slewed; once settled."""
        return round(self._offset)

    @property
    def latest_ns(self) -> int:
        """The least lateness of the last seconds, as it is."""
        return min(self._least) + self._step_ns

    def observe(self, sensor_ns: int, arrival_ns: int) -> None:
        """A message: when it was complete by the sensor's clock, and when it came."""
        late_ns = arrival_ns - sensor_ns - self._step_ns
        if self._first_ns is None:
            self._first_ns = self._block_ns = self._moved_ns = arrival_ns
            self._least.append(late_ns)
        elif arrival_ns - self._block_ns >= _BLOCK_NS:
            self._end_block()
            self._block_ns = arrival_ns
            self._least.append(late_ns)
        else:
            self._least[-1] = min(self._least[-1], late_ns)
        if self.settled:
            self._move(arrival_ns)
        elif arrival_ns - self._first_ns >= SETTLE_NS:
            self.settle()

    def settle(self) -> None:
        """Takes what has been heard so far as enough."""
        self._offset, self._moved_ns = float(min(self._least)), self._block_ns

    def waited_ns(self, now_ns: int) -> int:
        """Since the first message; 0 before it."""
        return 0 if self._first_ns is None else now_ns - self._first_ns

    def _move(self, arrival_ns: int) -> None:
        room = _SLEW * max(arrival_ns - self._moved_ns, 0)
        self._moved_ns = max(self._moved_ns, arrival_ns)
        target = min((ns for ns in self._least if abs(ns - self._offset) < _OUTLIER_NS), default=self._offset)
        self._offset += min(max(target - self._offset, -room), room)

    def _end_block(self) -> None:
        """Some seconds of another lateness: the sensor's clock has stepped, and goes on from there."""
        if not self.settled or abs(self._least[-1] - self._offset) < _OUTLIER_NS:
            self._off = 0
            return
        self._off += 1
        if self._off == _STEPPED_BLOCKS:
            self._step_ns += round(self._least[-1] - self._offset)
            self._least.clear()
            self._least.append(round(self._offset))
            self._off = 0


@dataclass(slots=True)
class SensorClock:
    """One clock of the robot's sensors. base: as its messages say; `chosen`: how its stamps come into the run.

    age: counts on when, before the choice, another time base begins: messages of before cannot be placed.
    """

    name: str
    lateness: Lateness
    base: TimeBase = TimeBase.OWN
    locked: bool = False
    chosen: str = ""
    age: int = 0

    def heard(self, sensor_ns: int, arrival_ns: int, base: TimeBase) -> None:
        """A message, and whose time its stamp is in; GPS and PTP only while it is locked to them."""
        if base is not self.base and not self.chosen:
            self.lateness, self.age = Lateness(), self.age + 1
        self.lateness.observe(sensor_ns, arrival_ns)
        locked = base in (TimeBase.GPS, TimeBase.PTP)
        if self.chosen and locked != self.locked:
            event = "sensor clock locked" if locked else "sensor clock not locked any more"
            _log.warning(event, extra=fields(sensor=self.name, taken_from=self.chosen))
        self.base, self.locked = base, locked


class RunClock:
    """The one map from all clocks to the run's time, chosen once and for all when the sensors have settled.

    problems: what is wrong with the clocks, one line each, for people.
    """

    def __init__(self, choice: ClockChoice, apart_s: float, waits_for: Sequence[str]) -> None:
        """waits_for: names of the clocks that may be the reference, the best first."""
        self._choice, self._apart_ns = choice, round(apart_s * 1e9)
        self._waits_for = tuple(waits_for)
        self._reference: SensorClock | None = None
        self._began_ns: int | None = None
        self._decided = False
        self.clocks: dict[str, SensorClock] = {}
        self.problems: list[str] = []

    def clock(self, name: str) -> SensorClock:
        """The clock of that name; sensors in one housing share one."""
        return self.clocks.setdefault(name, SensorClock(name, Lateness()))

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
        heard = [clock for name in self._waits_for if (clock := self.clock(name)).lateness.settled]
        if len(heard) < len(self._waits_for) and now_ns - self._began_ns < _PATIENCE_NS:
            return False
        self._reference, self._decided = self._best(heard), True
        return True

    def offset_ns(self, clock: SensorClock) -> int:
        """What to add to the clock's stamps, ns."""
        if clock.chosen in (TimeBase.GPS.value, TimeBase.PTP.value):
            return 0
        return clock.lateness.offset_ns - self.host_lateness_ns

    @property
    def host_lateness_ns(self) -> int:
        """By how much our own clock is ahead of the run's time; 0 where the run's time is our own."""
        return 0 if self._reference is None else self._reference.lateness.offset_ns

    def all(self) -> list[SensorClock]:
        """Every clock there is."""
        return list(self.clocks.values())

    def behind_s(self) -> dict[str, float]:
        """By how much each clock is behind ours, its messages' way included, s."""
        return {clock.name: clock.lateness.latest_ns * 1e-9 for clock in self.all() if clock.lateness.settled}

    def _best(self, heard: Sequence[SensorClock]) -> SensorClock | None:
        if self._choice == "host":
            return None
        wanted = (TimeBase.GPS, TimeBase.PTP) if self._choice == "auto" else (TimeBase(self._choice),)
        return next((clock for base in wanted for clock in heard if clock.base is base), None)

    def _choose(self, clock: SensorClock) -> None:
        """Its own stamps where they are of the reference's time base and say so rightly, else when messages come."""
        reference, base = self._reference, clock.base
        apart_ns = clock.lateness.offset_ns - self.host_lateness_ns
        clock.chosen = "host"
        if clock.name == "gnss" and self._choice != "host" and -self._apart_ns <= apart_ns <= _FIX_LATE_NS:
            clock.chosen = base.value  # UTC, and the run's time is too: late by the receiver's own work
        elif reference is not None and base is reference.base:
            if abs(apart_ns) <= self._apart_ns:
                clock.chosen = base.value
            else:
                self._wrong(
                    f"{clock.name}: its {base.value} time is {apart_ns * 1e-9:+.3f} s behind {reference.name}'s"
                )
        elif self._choice not in ("auto", "host") and base.value != self._choice:
            self._wrong(f"{clock.name}: not locked to {self._choice}, as clock: {self._choice} asks")
        said = fields(sensor=clock.name, taken_from=clock.chosen, behind_s=round(clock.lateness.offset_ns * 1e-9, 4))
        _log.warning("sensor clock chosen", extra=said)

    def _wrong(self, line: str) -> None:
        self.problems.append(f"{line}; it is stamped when its messages come")
        _log.warning("sensor clocks disagree", extra=fields(detail=line))
