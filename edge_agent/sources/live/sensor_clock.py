"""One clock of a robot's sensors, and what is added to its stamps."""

from __future__ import annotations

import logging
from collections import deque
from enum import StrEnum

from edge_agent.sources.live.lateness import Lateness
from splitslam.logs import fields

_log = logging.getLogger(__name__)

_FOLLOW = 1e-3  # so fast an offset moves to where it belongs: a stamp's step is off by a thousandth, and none goes back
_STEPS = 64  # of stamps, the least of which is the sensor's period
_JITTER = 2.5  # periods: by so much our own clock may misjudge how long a message was on its way


class TimeBase(StrEnum):
    """Whose time a sensor's stamps are in."""

    GPS = "gps"
    PTP = "ptp"
    OWN = "own"  # a clock that nobody sets, or that says that it is not locked
    NONE = "none"  # no clock: stamps are when the message came


LOCKED = (TimeBase.GPS, TimeBase.PTP)


class SensorClock:
    """base: whose time its stamps are in, as its messages say; chosen: how they come into the run, "" not known yet.

    When a lock comes or goes the clock may step. The stream goes on over it: what is added to the stamps changes by as
    much, told by the sensor's own even period. steady: the motion is computed from this stream, so that afterwards its
    offset only drifts to where the new lock has it. Without, its messages wait until they are placed anew.

    age: counts on whenever messages of before cannot be placed any more. undecided: the lock has changed since then.
    changes: how often a lock has come or gone while the run went on.
    """

    def __init__(self, name: str, steady: bool = True) -> None:
        self.name, self._steady = name, steady
        self.lateness = Lateness()
        self.base = TimeBase.OWN
        self.chosen = ""
        self.age = self.changes = 0
        self.undecided = False
        self._offset_ns: int | None = None  # what is added to stamps
        self._moved_ns = 0  # arrival until which it has followed
        self._last: tuple[int, int] | None = None  # sensor's stamp and arrival of the newest message
        self._steps_ns: deque[int] = deque(maxlen=_STEPS)

    @property
    def locked(self) -> bool:
        """As its messages say."""
        return self.base in LOCKED

    def heard(self, sensor_ns: int, arrival_ns: int, base: TimeBase) -> None:
        """A message, and whose time its stamp is in; GPS and PTP only while it is locked to them."""
        if base is not self.base:
            self._change(sensor_ns, arrival_ns, base)
        elif self._last is not None and sensor_ns > self._last[0]:
            self._steps_ns.append(sensor_ns - self._last[0])
        self._last = sensor_ns, arrival_ns
        self.lateness.observe(sensor_ns, arrival_ns)

    def _change(self, sensor_ns: int, arrival_ns: int, base: TimeBase) -> None:
        locked, self.base, self.lateness = self.locked, base, Lateness()
        if not self.chosen:
            self.age += 1
            return
        self.changes += 1
        step_ns = self._step_ns(sensor_ns, arrival_ns)
        if self._steady and self._offset_ns is not None:
            self._offset_ns -= step_ns
            self.chosen, self.undecided = "host", True
        else:
            self.chosen, self.age = "", self.age + 1
        if locked != self.locked:
            event = "sensor clock locked" if self.locked else "sensor clock not locked any more"
            _log.warning(event, extra=fields(sensor=self.name, stepped_s=round(step_ns * 1e-9, 6)))

    def _step_ns(self, sensor_ns: int, arrival_ns: int) -> int:
        """By how much its clock has stepped between the last message and this one."""
        if self._last is None:
            return 0
        last_ns, came_ns = self._last
        passed_ns, period_ns = arrival_ns - came_ns, min(self._steps_ns, default=0)
        if period_ns:
            passed_ns = max(round(passed_ns / period_ns), 1) * period_ns
        step_ns = sensor_ns - last_ns - passed_ns
        return 0 if abs(step_ns) <= _JITTER * period_ns else step_ns

    def follow(self, wanted_ns: int | None) -> int:
        """What is added to its stamps now, ns; None: not known yet, it stays as it is."""
        arrival_ns = 0 if self._last is None else self._last[1]
        if wanted_ns is not None:
            if self._offset_ns is None or not self._steady:
                self._offset_ns = wanted_ns
            room_ns = round(_FOLLOW * max(arrival_ns - self._moved_ns, 0))
            self._offset_ns += min(max(wanted_ns - self._offset_ns, -room_ns), room_ns)
        self._moved_ns = max(self._moved_ns, arrival_ns)
        return self._offset_ns or 0
