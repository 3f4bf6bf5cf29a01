"""Writes the tables of docs/metrics.md from the programs' own lists: `python -m docs.make_metrics` (`--check`: none).

What stands between the marks is replaced; the rest of the page is written by hand.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

from edge_agent.metric_list import EDGE_METRICS
from map_service.metric_list import MAP_METRICS, ROBOT_METRICS
from splitslam.metrics import BUILD_INFO, OTHER, Label, Metric

PAGE = Path(__file__).parent / "metrics.md"
_BEGIN, _END = "<!-- {}: made by `python -m docs.make_metrics` -->", "<!-- end of {} -->"
TABLES = {
    "both": (BUILD_INFO,),
    "edge": EDGE_METRICS,
    "service": tuple(metric for metric in MAP_METRICS if metric not in ROBOT_METRICS),
    "robots": ROBOT_METRICS,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="only say whether the page is as the code has it")
    text = PAGE.read_text()
    made = filled(text)
    if parser.parse_args().check:
        sys.exit(0 if made == text else f"{PAGE}: not as the code has it; run python -m docs.make_metrics")
    PAGE.write_text(made)


def filled(text: str) -> str:
    """The page with its tables made anew."""
    for name, metrics in TABLES.items():
        begin, end = _BEGIN.format(name), _END.format(name)
        before, _, rest = text.partition(begin)
        _, found, after = rest.partition(end)
        if not found:
            raise ValueError(f"{PAGE}: expected the lines {begin!r} and {end!r}")
        text = f"{before}{begin}\n{table(metrics)}\n{end}{after}"
    return text


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


if __name__ == "__main__":
    main()
