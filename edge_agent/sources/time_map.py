"""From the sensors' clocks to the time of the run, which only goes forward and takes no part in their steps.

A stream's clock steps when somebody sets the clock that stamps it, or when its driver starts anew with another idea of
the time. Streams that are stamped by one clock step together, and must be put back by the same amount to the
nanosecond, or they would be out of step with each other afterwards.
"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass, replace
from typing import TypeVar

from splitslam.logs import fields
from splitslam.scan import GnssFix, ImuSamples, Scan, WheelSamples

ALIKE_NS = 300_000_000  # steps that differ by less are one: stamps and arrivals jitter
_TOGETHER_NS = 20_000_000_000
_log = logging.getLogger(__name__)
Message = Scan | ImuSamples | WheelSamples | GnssFix
T = TypeVar("T", bound=Message)


@dataclass(frozen=True, slots=True)
class _Step:
    change_ns: int
    arrival_ns: int


class TimeMap:
    """The steps of all streams of a run. steps: how many were put right, by stream."""

    def __init__(self) -> None:
        self.steps: Counter[str] = Counter()
        self._recent: list[_Step] = []

    def known(self, change_ns: int, arrival_ns: int) -> int | None:
        """The step of another stream that `change_ns` (what to add to stamps) seems to be, None for none."""
        self._recent = [s for s in self._recent if abs(arrival_ns - s.arrival_ns) < _TOGETHER_NS]
        alike = [s.change_ns for s in self._recent if abs(s.change_ns - change_ns) < ALIKE_NS]
        return alike[0] if alike else None

    def step(self, stream: str, change_ns: int, arrival_ns: int) -> None:
        """A stream's stamps get `change_ns` added from now on."""
        self.steps[stream] += 1
        if self.known(change_ns, arrival_ns) is None:
            self._recent.append(_Step(change_ns, arrival_ns))
        said = fields(stream=stream, step_s=round(-change_ns * 1e-9, 3))
        _log.warning("clock stepped, stamps go on as before", extra=said)


def shifted(item: T, by_ns: int) -> T:
    """The message with `by_ns` added to its stamps."""
    if by_ns == 0:
        return item
    if isinstance(item, Scan):
        return replace(item, stamp_ns=item.stamp_ns + by_ns, end_ns=item.end_ns + by_ns)
    if isinstance(item, GnssFix):
        return replace(item, stamp_ns=item.stamp_ns + by_ns)
    return replace(item, stamps_ns=item.stamps_ns + by_ns)
