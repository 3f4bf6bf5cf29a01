"""Messages that never came, by the gaps that they leave: CycloneDDS does not say what best-effort delivery has lost."""

from __future__ import annotations

import statistics
from collections import Counter, deque

_LEARNT = 50  # steps between stamps that say how often messages come
_LONGEST_NS = 1_000_000_000  # a longer gap is a sensor that has stopped


class Missing:
    """One topic of a sensor that sends at an even rate. Counts into `dropped[reason]`."""

    def __init__(self, reason: str, dropped: Counter[str]) -> None:
        self._reason, self._dropped = reason, dropped
        self._steps_ns: deque[int] = deque(maxlen=_LEARNT)
        self._period_ns = 0.0  # 0: not known yet
        self._last_ns: int | None = None
        self._until_learnt = _LEARNT

    def saw(self, stamp_ns: int) -> None:
        """The next message, by the stamp of its header."""
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if last_ns is None or not 0 < stamp_ns - last_ns <= _LONGEST_NS:
            return
        step_ns = stamp_ns - last_ns
        self._steps_ns.append(step_ns)
        if self._period_ns:
            self._count(step_ns)
        self._until_learnt -= 1
        if self._until_learnt == 0:
            first = not self._period_ns
            self._until_learnt = _LEARNT
            self._period_ns = statistics.median(self._steps_ns)
            for step_before_ns in self._steps_ns if first else ():
                self._count(step_before_ns)

    def _count(self, step_ns: int) -> None:
        missing = round(step_ns / self._period_ns) - 1
        if missing > 0:
            self._dropped[self._reason] += missing
