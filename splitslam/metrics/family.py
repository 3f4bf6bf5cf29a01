"""A metric's live series: all of them are there from the start, and there can be no others."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

from splitslam.metrics.definition import OTHER, Kind, Metric


class Family:
    """The series of one metric in one registry.

    They exist with zero from the beginning, so that `increase()` sees the first event, and a panel a line. given: by
    label, the values that a configuration says.
    """

    def __init__(self, metric: Metric, registry: CollectorRegistry, **given: Iterable[str]) -> None:
        self.metric = metric
        parent = _parent(metric, registry)
        series = metric.series({name: tuple(values) for name, values in given.items()})
        self._series: dict[tuple[str, ...], Any] = {
            values: parent.labels(*values) if values else parent for values in series
        }
        self._open = tuple(label.open for label in metric.labels)
        self._known = tuple({values[i] for values in series} for i in range(len(metric.labels)))

    def of(self, *values: str) -> Any:
        """The series with these label values: prometheus_client's. KeyError for values that a closed label lacks."""
        found = self._series.get(values)
        return self._series[self._with_other(values)] if found is None else found

    def _with_other(self, values: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(
            OTHER if is_open and value not in known else value
            for value, is_open, known in zip(values, self._open, self._known, strict=True)
        )

    def inc(self, *values: str, by: float = 1.0) -> None:
        self.of(*values).inc(by)

    def set(self, value: float, *values: str) -> None:
        self.of(*values).set(value)

    def observe(self, value: float, *values: str) -> None:
        self.of(*values).observe(value)

    def values(self) -> dict[tuple[str, ...], float]:
        """Every series of a counter or gauge by its label values."""
        return {labels: series._value.get() for labels, series in self._series.items()}


def _parent(metric: Metric, registry: CollectorRegistry) -> Counter | Gauge | Histogram:
    names = metric.label_names
    if metric.kind == Kind.HISTOGRAM:
        return Histogram(metric.name, metric.text, names, buckets=metric.buckets, registry=registry)
    return (Counter if metric.kind == Kind.COUNTER else Gauge)(metric.name, metric.text, names, registry=registry)
