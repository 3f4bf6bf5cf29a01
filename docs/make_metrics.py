"""Writes the tables of docs/metrics.md from the programs' lists: `python -m docs.make_metrics` (`--check`: none)."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from docs.made import MadePage
from edge_agent.metric_list import EDGE_METRICS
from map_service.metric_list import SERVICE_METRICS
from map_service.robot_metric_list import ROBOT_METRICS
from splitslam.metrics import BUILD_INFO, OTHER, Label, Metric

METRICS = {
    "both": (BUILD_INFO,),
    "edge": EDGE_METRICS,
    "service": SERVICE_METRICS,
    "robots": ROBOT_METRICS,
}


def table(metrics: Iterable[Metric]) -> str:
    """A Markdown table, one row a metric."""
    rows = ["| metric | type | labels | what it is | when it moves, look at |", "|---|---|---|---|---|"]
    for metric in metrics:
        labels = "<br>".join(_label(label) for label in metric.labels)
        cells = (f"`{metric.shown}`", str(metric.kind), labels, metric.text, metric.look)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def _label(label: Label) -> str:
    values = [f"`{value}`" for value in (*label.values, *((OTHER,) if label.open else ()))]
    return f"{label.name}: {', '.join([*values, *((label.bound,) if label.bound else ())])}"


PAGE = MadePage("metrics", {part: partial(table, metrics) for part, metrics in METRICS.items()})

if __name__ == "__main__":
    PAGE.main(__doc__)
