"""Two real agents and two real replicas under a real Prometheus: every panel shows something, every fault is seen."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from deploy.grafana.boards import BOARDS
from deploy.grafana.boards.panel import Board, Panel
from splitslam.top.rows import ReplicaRow, RobotRow
from tests.monitoring.alert_rules import RULES, metrics_of, rules
from tests.monitoring.prometheus import Prometheus
from tests.monitoring.scenario import CALM, SICK, Watched, watched_fleet

ROBOTS = (CALM, SICK)
WINDOW = "5s"  # of rates, at a scrape a second


def filled_in(expr: str, robot: str) -> str:
    """With the dashboards' variables chosen."""
    for name, value in (("$__rate_interval", WINDOW), ("$robot", robot), ("$replica", ".*")):
        expr = expr.replace(name, value)
    assert "$" not in expr
    return expr


def shown(watched: Watched, panel: Panel, robots: Iterable[str], span: tuple[float, float]) -> list[float]:
    """Every number that the panel's queries give in that time."""
    ask = watched.prometheus.series
    series = [ask(filled_in(query.expr, robot), *span) for query in panel.queries for robot in robots]
    return [value for one in series for values in one for value in values if not math.isnan(value)]


def empty(watched: Watched, board: Board) -> list[str]:
    """Panels with a query that gives no number in the whole run."""
    span = watched.calm[0], watched.harmed[1]
    return [
        f"{board.title} / {panel.title}: {query.expr}"
        for panel in board.panels
        for query in panel.queries
        if not shown(watched, Panel(panel.title, "", (query,)), ROBOTS, span)
    ]


def calm_is_not_zero(watched: Watched, panel: Panel) -> float:
    return max(shown(watched, panel, (CALM,), watched.calm), default=0.0)


def highest(watched: Watched, panel: Panel) -> float:
    return max(shown(watched, panel, ROBOTS, watched.harmed), default=0.0)


def unknown_metrics(prometheus: Prometheus) -> list[str]:
    """What the rules ask for and no program has, nor a rule records."""
    known = {*prometheus.ask("label/__name__/values"), *(rule.name for rule in rules() if not rule.alert)}
    return [f"{rule.name}: {name}" for rule in rules() for name in sorted(metrics_of(rule.expr) - known)]


def test_no_panel_is_empty_each_fault_is_seen_on_its_panel_and_top_shows_the_same(tmp_path: Path) -> None:
    with watched_fleet(tmp_path, RULES) as watched:
        boards = BOARDS.values()
        assert [text for board in boards for text in empty(watched, board)] == []
        faults = [(board, panel) for board in boards for panel in board.panels if panel.fault]
        blind = [
            f"{board.title} / {panel.title}: {calm_is_not_zero(watched, panel):g} -> {highest(watched, panel):g}"
            for board, panel in faults
            if not highest(watched, panel) > calm_is_not_zero(watched, panel)
        ]
        assert blind == []
        assert unknown_metrics(watched.prometheus) == []
        calm, harmed = watched.screens
    robots = [row for row in calm.rows if isinstance(row, RobotRow)]
    replicas = [row for row in calm.rows if isinstance(row, ReplicaRow)]
    assert [row.state for row in robots] == ["tracking", "tracking"]
    assert sum(row.streams for row in replicas) == 2
    assert len(harmed.events) > len(calm.events)
