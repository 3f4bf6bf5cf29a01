"""Holds messages back on the wall clock: what was kept during an outage must not burst through the uplink's limit, and
what is not live goes only where live frames leave room.
"""

from __future__ import annotations

from collections import deque

_WINDOW_S = 5.0
_CEILING = 1.05  # of the limit, in any window; live frames alone stay below 1 (edge_agent/rate.py)
_SPARE_CEILING = 0.95  # the same with what is not live
_PEAK_S = 60.0  # live frames may need again what they have needed within this time
_BYTES_PER_KBIT = 125.0
_LEAST_S = 1e-3


class _Window:
    """What was sent in the last seconds."""

    def __init__(self) -> None:
        self._sent: deque[tuple[float, int]] = deque()
        self.bytes = 0

    def at(self, now_s: float) -> int:
        """Its bytes now."""
        while self._sent and self._sent[0][0] <= now_s - _WINDOW_S:
            self.bytes -= self._sent.popleft()[1]
        return self.bytes

    def add(self, now_s: float, size: int) -> int:
        """Its bytes with a further message."""
        self._sent.append((now_s, size))
        self.bytes += size
        return self.at(now_s)

    def wait_s(self, now_s: float, over: float) -> float:
        """When so many bytes more than fit will have left it."""
        for sent_s, size in self._sent:
            over -= size
            if over <= 0:
                return max(sent_s + _WINDOW_S - now_s, _LEAST_S)
        return max(self._sent[-1][0] + _WINDOW_S - now_s, _LEAST_S) if self._sent else _WINDOW_S


class Pacer:
    """Sliding windows over what was sent; times on the caller's clock."""

    def __init__(self) -> None:
        self._all, self._live, self._spare = _Window(), _Window(), _Window()
        self._peaks: deque[tuple[float, int]] = deque()  # live windows that none after them has reached
        self._live_since_s = float("inf")

    def wait_s(self, now_s: float, size: int, limit_kbps: float | None) -> float:
        """How long a live message of `size` bytes has to wait; 0: it may go. One alone may always go."""
        sent = self._all.at(now_s)
        if limit_kbps is None or not sent:
            return 0.0
        over = sent + size - _CEILING * _room(limit_kbps)
        return 0.0 if over <= 0 else self._all.wait_s(now_s, over)

    def spare_s(self, now_s: float, size: int, limit_kbps: float | None, *, live: bool) -> float:
        """The same for one that is not live: it leaves live ones the room of their largest window of the last minute.

        live: there are any; else all of the limit is to spare.
        """
        if limit_kbps is None:
            return 0.0
        if live and now_s < self._live_since_s + _WINDOW_S:  # what they need is not known yet
            return _WINDOW_S
        while self._peaks and self._peaks[0][0] <= now_s - _PEAK_S:
            self._peaks.popleft()
        peak = self._peaks[0][1] if self._peaks and live else self._live.at(now_s)
        over = self._spare.at(now_s) + size + peak - _SPARE_CEILING * _room(limit_kbps)
        return 0.0 if over <= 0 else self._spare.wait_s(now_s, over)

    def sent(self, now_s: float, size: int, *, live: bool = True) -> None:
        """Books a message."""
        self._all.add(now_s, size)
        if not live:
            self._spare.add(now_s, size)
            return
        self._live_since_s = min(self._live_since_s, now_s)
        window = self._live.add(now_s, size)
        while self._peaks and self._peaks[-1][1] <= window:
            self._peaks.pop()
        self._peaks.append((now_s, window))


def _room(limit_kbps: float) -> float:
    """Bytes of a window."""
    return limit_kbps * _BYTES_PER_KBIT * _WINDOW_S
