"""docs/metrics.md is what the programs' own lists say, and those follow Prometheus' conventions."""

from __future__ import annotations

import re

import pytest

from docs import make_metrics
from edge_agent.metric_list import EDGE_METRICS
from map_service.metric_list import MAP_METRICS
from splitslam.metrics import BUILD_INFO, Kind, Metric

ALL = (BUILD_INFO, *EDGE_METRICS, *MAP_METRICS)
UNITS = re.compile(r"(^|_)(ms|us|ns|millis\w*|minutes|hours|kb|kbps|mb|bits|degrees|deg|percent|cm|mm)(_|$)")


def test_the_page_is_as_the_code_has_it() -> None:
    page = make_metrics.PAGE.path.read_text()
    assert page == make_metrics.PAGE.filled(page), "stale: run python -m docs.make_metrics"


@pytest.mark.parametrize("metric", ALL, ids=lambda metric: metric.name)
def test_a_metric_is_named_and_described_as_prometheus_wants_it(metric: Metric) -> None:
    assert re.fullmatch(r"splitslam_(edge|map|build)_[a-z][a-z_]*[a-z]", metric.name)
    assert not UNITS.search(metric.name), "not a base unit"
    assert not metric.name.endswith(("_total", "_count", "_sum", "_bucket", "_created")), "the library's own"
    assert len(metric.text) > 3
    assert len(metric.look) > 3
    assert list(metric.buckets) == sorted(set(metric.buckets))
    assert bool(metric.buckets) == (metric.kind == Kind.HISTOGRAM)
    for label in metric.labels:
        assert label.values or label.bound
        assert len(set(label.values)) == len(label.values)


def test_no_two_metrics_have_one_name() -> None:
    assert len({metric.name for metric in ALL}) == len(ALL)
