"""What a dashboard is made of, in the words of the people who read it; build.py turns it into Grafana's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

Kind = Literal["lines", "stacked", "number", "states", "table"]
COLUMNS = 24  # of Grafana's grid


@dataclass(frozen=True, slots=True)
class Query:
    """PromQL, and what its series are called ({{label}}); in a table, the column's head, unit and thresholds."""

    expr: str
    legend: str = ""
    unit: str = ""
    warn: float | None = None
    bad: float | None = None


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture. unit: Grafana's id. warn, bad: from there on the value is yellow, red; `low`: below it instead.

    fault: zero while all is well; a test breaks what it watches and sees it rise. key: of a table, the label
    that its rows are joined by. link: uid of the dashboard that a row of the table leads to.
    """

    title: str
    what: str
    queries: tuple[Query, ...]
    kind: Kind = "lines"
    unit: str = "short"
    warn: float | None = None
    bad: float | None = None
    low: bool = False
    fault: bool = False
    width: int = 8
    key: str = ""
    link: str = ""


def number(title: str, what: str, expr: str, unit: str = "short", **more: Any) -> Panel:
    """One figure and its course, an eighth of the page wide."""
    return Panel(title, what, (Query(expr),), "number", unit, **{"width": 3, **more})


def lines(title: str, what: str, *queries: Query, unit: str = "short", **more: Any) -> Panel:
    """Curves over time, a quarter of the page wide."""
    return Panel(title, what, queries, unit=unit, **{"width": 6, **more})


@dataclass(frozen=True, slots=True)
class Row:
    """Panels side by side, in as many lines as they take; height of each line in Grafana's units of 30 pixels."""

    title: str
    panels: tuple[Panel, ...]
    height: int = 7


@dataclass(frozen=True, slots=True)
class Variable:
    """A choice at the top of the page: all values of a label of a metric."""

    name: str
    label: str
    metric: str
    of: str
    multi: bool = True


@dataclass(frozen=True, slots=True)
class Board:
    """One dashboard."""

    uid: str
    title: str
    what: str
    rows: tuple[Row, ...]
    variables: tuple[Variable, ...] = ()

    @property
    def panels(self) -> tuple[Panel, ...]:
        return tuple(panel for row in self.rows for panel in row.panels)
