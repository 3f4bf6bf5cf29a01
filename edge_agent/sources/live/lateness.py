"""How late a sensor's messages come: what its clock, its line and the system add up to, and the least of it."""

from __future__ import annotations

import math
from collections import deque

SETTLE_NS = 1_000_000_000  # of a sensor's first messages, before it is known how late they come
_BLOCK_NS = 1_000_000_000
_BLOCKS = 8
_SLEW = 200e-6  # crystals differ by up to 100 ppm; faster than that no offset moves, so that no stamp goes back
_OUTLIER_NS = 100_000_000  # a step of the sensor's clock, not a late message: the offset does not follow it
_STEPPED_BLOCKS = 3


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
