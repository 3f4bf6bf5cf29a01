"""Metrics of both sides: what there is (definition), how it is kept (family, collected), how it is served (page)."""

from __future__ import annotations

from prometheus_client import disable_created_metrics

from splitslam.metrics.build import BUILD_INFO, show_build
from splitslam.metrics.collected import collect
from splitslam.metrics.definition import OTHER, Kind, Label, Metric
from splitslam.metrics.family import Family
from splitslam.metrics.page import Page

__all__ = ["BUILD_INFO", "OTHER", "Family", "Kind", "Label", "Metric", "Page", "collect", "show_build"]

disable_created_metrics()  # a second series for each, with the time of the program's start: process_start_time_seconds
