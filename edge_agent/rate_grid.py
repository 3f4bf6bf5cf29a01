"""Which samples of a fast stream are due at a slower rate."""

from __future__ import annotations


class RateGrid:
    """A grid of due times: intervals that are no multiple of the stream's still give the wanted mean rate."""

    def __init__(self, rate_hz: float) -> None:
        """rate_hz: 0: every sample is due."""
        self._interval_ns = int(1e9 / rate_hz) if rate_hz > 0 else 0
        self._next_ns = -(2**62)

    def due(self, stamp_ns: int) -> bool:
        """Whether the sample is to be taken; called once for each, in order of time. A step back starts anew."""
        if self._next_ns - self._interval_ns <= stamp_ns < self._next_ns:
            return False
        self._next_ns += self._interval_ns
        if not stamp_ns < self._next_ns <= stamp_ns + self._interval_ns:
            self._next_ns = stamp_ns + self._interval_ns
        return True
