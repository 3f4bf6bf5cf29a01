"""Stamps for a sensor without a clock, from when its messages came."""

from __future__ import annotations

_FOLLOW, _FOLLOW_PERIOD = 0.02, 0.0005  # of each error: a loop that settles in a second at 100 Hz, and averages 50
_LOST = 4.0  # periods: samples were lost, or the sensor was away


class SmoothedArrivals:
    """A phase-locked loop on arrivals: samples are evenly spaced, arrivals are late by turns."""

    def __init__(self) -> None:
        self._last_ns: float | None = None
        self._period_ns: float | None = None

    def stamps_ns(self, count: int, arrival_ns: int) -> list[int]:
        """Of `count` samples that came together, rising."""
        last_ns, period_ns = self._last_ns, self._period_ns
        if last_ns is None:
            self._last_ns = float(arrival_ns)
            return [arrival_ns - (count - 1 - k) for k in range(count)]
        if period_ns is None:
            period_ns = max((arrival_ns - last_ns) / count, 1.0)
        error_ns = arrival_ns - (last_ns + count * period_ns)
        if abs(error_ns) > _LOST * count * period_ns:
            last_ns, error_ns = max(arrival_ns - count * period_ns, last_ns), 0.0
        step_ns = max(period_ns + _FOLLOW * error_ns, 0.1 * period_ns)
        stamps_ns = [round(last_ns + (k + 1) * step_ns) for k in range(count)]
        self._last_ns = last_ns + count * step_ns
        self._period_ns = max(period_ns + _FOLLOW_PERIOD * error_ns, 1.0)
        return stamps_ns
