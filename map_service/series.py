"""A long series of durations in bounded memory."""

from __future__ import annotations

from array import array

import numpy as np

_KEPT = 1 << 14  # of each series, 32 kB at most twice


class Series:
    """Mean, deviation and largest of all values; quantiles of all up to 32,768, beyond that of evenly chosen ones."""

    def __init__(self) -> None:
        self._count, self._sum, self._squares, self._max = 0, 0.0, 0.0, 0.0
        self._kept, self._every = array("f"), 1

    def __len__(self) -> int:
        return self._count

    def add(self, value: float) -> None:
        """One more, not negative."""
        if self._count % self._every == 0:
            self._kept.append(value)
            if len(self._kept) == 2 * _KEPT:
                self._kept, self._every = self._kept[::2], 2 * self._every
        self._count += 1
        self._sum += value
        self._squares += value * value
        self._max = max(self._max, value)

    def summary(self) -> dict[str, float]:
        """{mean, std, p50, p99, max}; zeros when empty."""
        if not self._count:
            return dict.fromkeys(("mean", "std", "p50", "p99", "max"), 0.0)
        mean = self._sum / self._count
        p50, p99 = np.percentile(np.frombuffer(self._kept, np.float32), (50, 99))
        deviation = max(self._squares / self._count - mean * mean, 0.0) ** 0.5
        return {"mean": mean, "std": deviation, "p50": float(p50), "p99": float(p99), "max": self._max}
