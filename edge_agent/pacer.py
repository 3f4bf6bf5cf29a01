"""Holds frames back on the wall clock: what was kept during an outage must not burst through the uplink's limit."""

from __future__ import annotations

from collections import deque

_WINDOW_S = 5.0
_CEILING = 1.05  # of the limit, in any window; live frames alone stay below 1 (edge_agent/rate.py)
_BYTES_PER_KBIT = 125.0


class Pacer:
    """A sliding window over what was sent; times on the caller's clock."""

    def __init__(self) -> None:
        self._sent: deque[tuple[float, int]] = deque()
        self._sum = 0

    def wait_s(self, now_s: float, size: int, limit_kbps: float | None) -> float:
        """How long a message of `size` bytes has to wait; 0: it may go. One alone may always go."""
        while self._sent and self._sent[0][0] <= now_s - _WINDOW_S:
            self._sum -= self._sent.popleft()[1]
        if limit_kbps is None:
            return 0.0
        over = self._sum + size - _CEILING * limit_kbps * _BYTES_PER_KBIT * _WINDOW_S
        if over <= 0 or not self._sent:
            return 0.0
        for sent_s, bytes_sent in self._sent:
            over -= bytes_sent
            if over <= 0:
                return max(sent_s + _WINDOW_S - now_s, 1e-3)
        return max(self._sent[-1][0] + _WINDOW_S - now_s, 1e-3)

    def sent(self, now_s: float, size: int) -> None:
        """Books a message."""
        self._sent.append((now_s, size))
        self._sum += size
