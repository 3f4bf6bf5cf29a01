"""A metric's live series: all of them are there from the start, and there can be no others."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge

from splitslam.metrics.definition import OTHER, Kind, Metric
from splitslam.metrics.histogram import Observed, ObservedFamily


class Family:
    """The series of one metric in one registry.

    They exist with zero from the beginning, so that `increase()` sees the first event, and a panel a line. given: by
    label, the values that a configuration says.
    """

    def __init__(self, metric: Metric, registry: CollectorRegistry, **given: Iterable[str]) -> None:
        self.metric = metric
        series = metric.series({name: tuple(values) for name, values in given.items()})
        self._series = _series(metric, registry, series)
        self._open = tuple(label.open for label in metric.labels)
        self._known = tuple({values[i] for values in series} for i in range(len(metric.labels)))

    def of(self, *values: str) -> Any:
        """The series with these label values: prometheus_client's, or Observed.

        KeyError for values that a closed label lacks.
        """
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
        return {labels: self.of(*labels)._value.get() for labels in self._series}


def _series(
    metric: Metric, registry: CollectorRegistry, series: list[tuple[str, ...]]
) -> dict[tuple[str, ...], Counter | Gauge | Observed]:
    if metric.kind == Kind.HISTOGRAM:
        family = ObservedFamily(metric, series)
        registry.register(family)
        return dict(family.series)
    made = Counter if metric.kind == Kind.COUNTER else Gauge
    parent = made(metric.name, metric.text, metric.label_names, registry=registry)
    return {values: parent.labels(*values) if values else parent for values in series}
