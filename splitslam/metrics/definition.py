"""What a metric is: its name, its labels with every value they can have, what it means and what to look at.

docs/metrics.md is written from these records, and the series on /metrics are made from them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import product

OTHER = "other"


class Kind(StrEnum):
    COUNTER = "counter"
    GAUGE = "gauge"
    HISTOGRAM = "histogram"


@dataclass(frozen=True, slots=True)
class Label:
    """A label and its values. bound: what limits them where a configuration says them, not this code.

    open: values may come that are not listed, as from a newer program on the other side; they are counted as `other`.
    """

    name: str
    values: tuple[str, ...] = ()
    bound: str = ""
    open: bool = False

    def all(self, given: Mapping[str, Iterable[str]]) -> tuple[str, ...]:
        """Every value; given: by label name, those that a configuration says."""
        known = (*self.values, *(given[self.name] if self.bound else ()))
        return (*known, OTHER) if self.open else known


@dataclass(frozen=True, slots=True)
class Metric:
    """name: as the exposition has it, a counter's `_total` left out. text: what it is. look: at what when it moves."""

    name: str
    kind: Kind
    text: str
    look: str
    labels: tuple[Label, ...] = ()
    buckets: tuple[float, ...] = ()

    @property
    def shown(self) -> str:
        """The name in a query."""
        return f"{self.name}_total" if self.kind == Kind.COUNTER else self.name

    @property
    def label_names(self) -> tuple[str, ...]:
        return tuple(label.name for label in self.labels)

    def series(self, given: Mapping[str, Iterable[str]]) -> list[tuple[str, ...]]:
        """The label values of every series there can be."""
        return list(product(*(label.all(given) for label in self.labels)))


def counter(name: str, text: str, look: str, *labels: Label) -> Metric:
    return Metric(name, Kind.COUNTER, text, look, labels)


def gauge(name: str, text: str, look: str, *labels: Label) -> Metric:
    return Metric(name, Kind.GAUGE, text, look, labels)


def histogram(name: str, text: str, look: str, buckets: tuple[float, ...], *labels: Label) -> Metric:
    return Metric(name, Kind.HISTOGRAM, text, look, labels, buckets)
