"""Histograms that are added up when they are asked for: a robot observes a dozen values a scan, and is asked rarely."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Iterator
from itertools import accumulate

from prometheus_client.metrics_core import HistogramMetricFamily
from prometheus_client.registry import Collector
from prometheus_client.utils import floatToGoString

from splitslam.metrics.definition import Metric

_KEPT = 1_000  # observations that wait at most; 32 bytes each


class Observed:
    """One series. Any thread may observe; buckets end at `bounds`, rising, and at infinity."""

    def __init__(self, bounds: tuple[float, ...]) -> None:
        self._bounds = bounds
        self._counts = [0] * (len(bounds) + 1)
        self._sum = 0.0
        self._waiting: deque[float] = deque()
        self._lock = threading.Lock()

    def observe(self, value: float) -> None:
        """Costs an append."""
        self._waiting.append(value)
        if len(self._waiting) > _KEPT:
            self.totals()

    def totals(self) -> tuple[list[int], float]:
        """(counts up to each bound and to infinity, sum)."""
        with self._lock:
            for _ in range(len(self._waiting)):  # what comes meanwhile waits for the next time
                value = self._waiting.popleft()
                self._counts[bisect_left(self._bounds, value)] += 1
                self._sum += value
            return list(accumulate(self._counts)), self._sum


class ObservedFamily(Collector):
    """The series of one histogram as the exposition has them."""

    def __init__(self, metric: Metric, series: Iterable[tuple[str, ...]]) -> None:
        self.series = {labels: Observed(metric.buckets) for labels in series}
        self._metric = metric
        self._ends = [floatToGoString(bound) for bound in (*metric.buckets, float("inf"))]

    def describe(self) -> Iterator[HistogramMetricFamily]:
        yield self._family()

    def collect(self) -> Iterator[HistogramMetricFamily]:
        family = self._family()
        for labels, observed in self.series.items():
            counts, total = observed.totals()
            family.add_metric(list(labels), list(zip(self._ends, counts, strict=True)), total)
        yield family

    def _family(self) -> HistogramMetricFamily:
        return HistogramMetricFamily(self._metric.name, self._metric.text, labels=self._metric.label_names)
