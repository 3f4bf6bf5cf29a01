"""Metrics whose numbers others keep: read when /metrics is asked, and free until then."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from prometheus_client import CollectorRegistry
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from splitslam.metrics.definition import OTHER, Kind, Metric

Values = float | Mapping[str, float] | Mapping[tuple[str, ...], float]


def collect(metric: Metric, registry: CollectorRegistry, read: Callable[[], Values], **given: Iterable[str]) -> None:
    """Shows `metric` as `read` says: a number, or numbers by the value of its label, or by all of them.

    What a counter's `read` leaves out is 0, and what it says beyond the labels' values is added up as `other`.
    """
    registry.register(_Collected(metric, read, {name: tuple(values) for name, values in given.items()}))


class _Collected(Collector):
    def __init__(self, metric: Metric, read: Callable[[], Values], given: Mapping[str, Iterable[str]]) -> None:
        self._metric, self._read = metric, read
        self._zeros = dict.fromkeys(metric.series(given), 0.0)

    def describe(self) -> Iterator[CounterMetricFamily | GaugeMetricFamily]:
        yield self._family()

    def collect(self) -> Iterator[CounterMetricFamily | GaugeMetricFamily]:
        family, sums = self._family(), dict(self._zeros)
        values = self._read()
        for key, value in values.items() if isinstance(values, Mapping) else [((), values)]:
            labels = (key,) if isinstance(key, str) else key
            if labels not in self._zeros:
                labels = tuple(OTHER for _ in labels)
            sums[labels] = sums.get(labels, 0.0) + value
        for labels, value in sums.items():
            family.add_metric(list(labels), value)
        yield family

    def _family(self) -> CounterMetricFamily | GaugeMetricFamily:
        made = CounterMetricFamily if self._metric.kind == Kind.COUNTER else GaugeMetricFamily
        return made(self._metric.name, self._metric.text, labels=self._metric.label_names)
