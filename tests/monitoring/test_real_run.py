"""Two real agents and two real replicas under a real Prometheus: every panel shows something, every fault is seen."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import pytest

from deploy.grafana.boards import BOARDS
from deploy.grafana.boards.panel import Board, Panel
from splitslam.top.rows import ReplicaRow, RobotRow
from tests.monitoring.alert_rules import RULES, metrics_of, rules
from tests.monitoring.prometheus import Prometheus
from tests.monitoring.scenario import CALM, SICK, Watched, watched_fleet

ROBOTS = (CALM, SICK)
WINDOW = "15s"  # of rates, at a scrape a second: some come late on a busy machine
AT_ONCE = {"FramesLost", "SpoolDiskFails", "ClockStepped", "WorkerDied", "FramesRejected"}


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
    return [
        f"{board.title} / {panel.title}: {query.expr}"
        for panel in board.panels
        for query in panel.queries
        if not shown(watched, Panel(panel.title, "", (query,)), ROBOTS, watched.whole)
    ]


def unseen(watched: Watched, board: Board) -> list[str]:
    """Panels that are to show a fault and were never higher than they are while all is well."""
    found = []
    for panel in board.panels:
        before = max(shown(watched, panel, (CALM,), watched.calm), default=0.0)
        after = max(shown(watched, panel, ROBOTS, watched.whole), default=0.0)
        if panel.fault and not after > before:
            found.append(f"{board.title} / {panel.title}: {before:g}, then {after:g}")
    return found


def unknown_metrics(prometheus: Prometheus) -> list[str]:
    """What the rules ask for and no program has, nor a rule records."""
    known = {*prometheus.ask("label/__name__/values"), *(rule.name for rule in rules() if not rule.alert)}
    return [f"{rule.name}: {name}" for rule in rules() for name in sorted(metrics_of(rule.expr) - known)]


def failing(prometheus: Prometheus) -> list[str]:
    """Rules that Prometheus cannot evaluate."""
    groups = prometheus.ask("rules")["groups"]
    return [
        f"{rule['name']}: {rule.get('lastError')}" for one in groups for rule in one["rules"] if rule["health"] != "ok"
    ]


def firing(prometheus: Prometheus) -> set[str]:
    """Alerts that have fired by now; few have, as most hold on for minutes first."""
    return {alert["labels"]["alertname"] for alert in prometheus.ask("alerts")["alerts"] if alert["state"] == "firing"}


@pytest.mark.alone
def test_no_panel_is_empty_and_each_fault_is_seen_on_its_panel_by_the_alerts_and_by_top(tmp_path: Path) -> None:
    with watched_fleet(tmp_path, RULES) as watched:
        assert [text for board in BOARDS.values() for text in empty(watched, board)] == []
        assert [text for board in BOARDS.values() for text in unseen(watched, board)] == []
        assert unknown_metrics(watched.prometheus) == failing(watched.prometheus) == []
        assert firing(watched.prometheus) >= AT_ONCE
    calm, harmed = watched.screens
    assert [row.state for row in calm.rows if isinstance(row, RobotRow)] == ["tracking", "tracking"]
    assert sum(row.streams for row in calm.rows if isinstance(row, ReplicaRow)) == 2
    assert not any(row.rejected or row.refused or row.restarts for row in calm.rows if isinstance(row, ReplicaRow))
    said = {event.what for _, event in harmed.events}
    assert {"frame rejected: corrupt", "robot refused: bad_hello", "a worker died and was started again"} <= said
