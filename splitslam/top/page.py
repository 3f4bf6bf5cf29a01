"""One /metrics page, and what happened between two of them."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import Self

from prometheus_client.parser import text_string_to_metric_families

Labels = frozenset[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Page:
    """at_s: when it was read, monotonic clock. samples: value by sample name and labels."""

    at_s: float
    samples: dict[str, dict[Labels, float]]

    @classmethod
    def parse(cls, text: str, at_s: float) -> Self:
        """Raises ValueError for text that is not in Prometheus' format."""
        samples: dict[str, dict[Labels, float]] = defaultdict(dict)
        for family in text_string_to_metric_families(text):
            for sample in family.samples:
                samples[sample.name][frozenset(sample.labels.items())] = float(sample.value)
        return cls(at_s, dict(samples))

    def has(self, prefix: str) -> bool:
        """Whether a sample's name begins so."""
        return any(name.startswith(prefix) for name in self.samples)

    def value(self, name: str, **labels: str) -> float:
        """Sum over all samples that have these labels; NaN without any."""
        wanted = labels.items()
        found = [value for held, value in self.samples.get(name, {}).items() if wanted <= set(held)]
        return math.fsum(found) if found else math.nan

    def by(self, name: str, label: str) -> dict[str, float]:
        """Sums by the value of one label."""
        sums: dict[str, float] = {}
        for held, value in self.samples.get(name, {}).items():
            key = dict(held).get(label, "")
            sums[key] = sums.get(key, 0.0) + value
        return sums


@dataclass(frozen=True, slots=True)
class Span:
    """From one page of an endpoint to a later one; `before` None: from the start of its process."""

    before: Page | None
    now: Page

    @property
    def seconds(self) -> float:
        """NaN without a page before."""
        return math.nan if self.before is None else self.now.at_s - self.before.at_s

    def increases(self, name: str, label: str) -> dict[str, float]:
        """Of a counter, by the value of one label; one that has started anew counts from zero."""
        old = {} if self.before is None else self.before.by(name, label)
        return {
            key: value - old.get(key, 0.0) if value >= old.get(key, 0.0) else value
            for key, value in self.now.by(name, label).items()
        }

    def increase(self, name: str, **labels: str) -> float:
        """Of a counter's sum; NaN when the endpoint has no such counter."""
        now, old = self.now.value(name, **labels), 0.0
        if self.before is not None and not math.isnan(value := self.before.value(name, **labels)):
            old = value
        return now - old if now >= old else now

    def rate(self, name: str, **labels: str) -> float:
        """A second; NaN while there is one page alone."""
        return self.increase(name, **labels) / self.seconds if self.seconds > 0 else math.nan

    def quantile(self, name: str, share: float) -> float:
        """Of a histogram's observations in the span, linear within a bucket as PromQL has it; NaN without any."""
        counts = sorted((float(le), count) for le, count in self.increases(f"{name}_bucket", "le").items())
        if not counts or counts[-1][1] <= 0:
            return math.nan
        rank, lower, below = share * counts[-1][1], 0.0, 0.0
        for upper, count in counts:
            if count >= rank:
                if math.isinf(upper):
                    return lower
                return lower + (upper - lower) * (rank - below) / (count - below) if count > below else upper
            lower, below = upper, count
        return lower

    def mean(self, name: str, **labels: str) -> float:
        """Of a histogram's observations in the span; NaN without any."""
        count = self.increase(f"{name}_count", **labels)
        return self.increase(f"{name}_sum", **labels) / count if count > 0 else math.nan
