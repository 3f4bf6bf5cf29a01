"""Rates over the last seconds of sensor time."""

from __future__ import annotations

from collections import deque

WINDOW_NS = 2_000_000_000


class Kbps:
    """Bytes of scans -> kbit/s over the last two seconds."""

    def __init__(self) -> None:
        self._sizes: deque[tuple[int, float]] = deque()

    def add(self, stamp_ns: int, size_bytes: float) -> float:
        """With one scan more; over the time that there is as long as it is less."""
        sizes = self._sizes
        while sizes and not 0 <= stamp_ns - sizes[0][0] < WINDOW_NS:
            sizes.popleft()
        sizes.append((stamp_ns, size_bytes))
        if len(sizes) < 2:
            return 0.0
        span_ns = (stamp_ns - sizes[0][0]) * len(sizes) / (len(sizes) - 1)  # n scans last n intervals
        return sum(size for _, size in sizes) * 8e6 / span_ns
