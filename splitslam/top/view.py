"""The screen of `splitslam top`: rows and events in, one picture out, no wider than the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rich.box import ROUNDED
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from splitslam.top.rows import ReplicaRow, RobotRow, Row, Silent
from splitslam.top.trouble import GOOD, GRAVE, LIGHT, Event

MIN_WIDTH, EVENTS = 100, 10
_SPARKS, _SPARK_CELLS = " ▁▂▃▄▅▆▇█", 14
_OK, _WARN, _BAD, _DIM, _BLUE = "#90e06d", "#f9c74f", "#ff6b6b", "#8a8f98", "#4cc9f0"
_WEIGHTS = {GRAVE: _BAD, LIGHT: _WARN, GOOD: _OK}
_STATES = {"tracking": _OK, "initialising": _BLUE, "starting": _BLUE, "detached": _DIM, "lost": _BAD}
_LATE_S, _VERY_LATE_S = 0.15, 0.5  # of a round trip: beyond a scan's period, and where the robot goes on alone
_SLOW_COMMIT_S = 1.0
_MANY_WAITING = 25


@dataclass(frozen=True, slots=True)
class Screen:
    """clock: what time it is, for people. events: (clock, event), oldest first."""

    rows: tuple[Row, ...]
    events: tuple[tuple[str, Event], ...]
    clock: str
    keys: bool = False


def render(screen: Screen) -> RenderableType:
    """Everything, from the title to the footer."""
    robots = [row for row in screen.rows if isinstance(row, RobotRow)]
    replicas = [row for row in screen.rows if isinstance(row, ReplicaRow)]
    silent = [row for row in screen.rows if isinstance(row, Silent)]
    parts: list[RenderableType] = [_title(screen, robots, replicas, silent)]
    parts += [_box("robots", _robots(robots))] if robots else []
    parts += [_box("map service", _replicas(replicas))] if replicas else []
    parts += [_box("no answer", _silent(silent))] if silent else []
    parts += [_box("what happened", _events(screen.events))] if screen.events else []
    parts += [Text(" q quit", _DIM)] if screen.keys else []
    return Group(*parts)


def _title(
    screen: Screen, robots: Sequence[RobotRow], replicas: Sequence[ReplicaRow], silent: Sequence[Silent]
) -> RenderableType:
    tracking = sum(robot.state == "tracking" and not robot.alone for robot in robots)
    title = Text(" SplitSLAM", "bold")
    if robots:
        title.append("   ").append_text(_light(tracking == len(robots), f"{tracking} of {len(robots)} robots tracking"))
    if replicas:
        frames = math.fsum(row.frames_per_s for row in replicas if not math.isnan(row.frames_per_s))
        title.append("   ").append_text(_light(True, f"{_count(len(replicas), 'replica')}, {frames:.0f} scans/s"))
    if silent:
        title.append("   ").append_text(_light(False, f"{len(silent)} without an answer"))
    line = Table.grid(expand=True)
    line.add_column()
    line.add_column(justify="right")
    line.add_row(title, Text(f"{screen.clock} ", _DIM))
    return line


def _robots(rows: Sequence[RobotRow]) -> Table:
    table = _table(
        "robot", "state", "scans/s", "round trip", "p99", "CPU/scan", "uplink kbit/s", "kept", "lost", "breaks"
    )
    highest_kbps = max((x for row in rows for x in row.uplinks_kbps if x == x), default=0.0)
    for row in rows:
        uplink = Text(f"{_sparks(row.uplinks_kbps, highest_kbps)} ", _BLUE).append(f"{_number(row.uplink_kbps):>5}", "")
        table.add_row(
            Text(f"● {row.name}", _robot_colour(row)),
            Text(f"{row.state}, alone" if row.alone else row.state, _robot_colour(row)),
            _number(row.scans_per_s, 1),
            _seconds(row.round_trip_p50_s),
            Text(_seconds(row.round_trip_p99_s), _late(row.round_trip_p99_s)),
            _seconds(row.cpu_s),
            uplink,
            Text(_kept(row), _WARN if row.waiting > _MANY_WAITING else ""),
            Text(_number(row.dropped), _BAD if row.dropped else _DIM),
            Text(_number(row.reconnects), "" if row.reconnects else _DIM),
        )
    return table


def _replicas(rows: Sequence[ReplicaRow]) -> Table:
    table = _table(
        *("replica", "sessions", "scans/s", "answer", "p99", "queue", "commit p99"),
        *("rejected", "refused", "died", "store"),
    )
    for row in rows:
        troubled = any(state in row.states for state in ("lost", "localising")) or row.commit_p99_s > _SLOW_COMMIT_S
        table.add_row(
            Text(f"● {row.name}", _WARN if troubled else _OK),
            _sessions(row.states),
            _number(row.frames_per_s, 1),
            _seconds(row.answer_p50_s),
            Text(_seconds(row.answer_p99_s), _late(row.answer_p99_s)),
            Text(_number(row.queue), _WARN if row.queue > _MANY_WAITING else ""),
            Text(_seconds(row.commit_p99_s), _BAD if row.commit_p99_s > _SLOW_COMMIT_S else ""),
            Text(_number(row.rejected), _BAD if row.rejected else _DIM),
            Text(_number(row.refused), _WARN if row.refused else _DIM),
            Text(_number(row.restarts), _BAD if row.restarts else _DIM),
            _bytes(row.database_bytes),
        )
    return table


def _silent(rows: Sequence[Silent]) -> Table:
    table = Table.grid(padding=(0, 2))
    for row in rows:
        table.add_row(Text(f"● {row.name}", _BAD), Text(row.problem, _BAD))
    return table


def _events(events: Sequence[tuple[str, Event]]) -> Table:
    table = Table.grid(padding=(0, 2))
    for clock, event in events:
        table.add_row(Text(clock, _DIM), Text(event.who), Text(event.text, _WEIGHTS[event.weight]))
    return table


# --- the small parts ----------------------------------------------------------------------------------------------


def _table(first: str, second: str, *numbers: str) -> Table:
    table = Table(box=None, expand=True, header_style=_DIM, padding=(0, 0, 0, 1))
    table.add_column(first, no_wrap=True)
    table.add_column(second, no_wrap=True)
    for name in numbers:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _box(title: str, inside: RenderableType) -> Panel:
    return Panel(inside, box=ROUNDED, title=Text(title, _DIM), title_align="left", border_style=_DIM, padding=(0, 1))


def _light(good: bool, text: str) -> Text:
    return Text.assemble(("● ", _OK if good else _BAD), text)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _robot_colour(row: RobotRow) -> str:
    return _BAD if row.alone else _STATES.get(row.state, _WARN)


def _sessions(states: dict[str, int]) -> Text:
    parts = Text()
    for state, number in states.items():
        parts.append(", " if parts else "").append(f"{number} {state}", _STATES.get(state, _WARN))
    return parts or Text("none", _DIM)


def _kept(row: RobotRow) -> str:
    size = f", {_bytes(row.spool_bytes)}" if row.waiting > _MANY_WAITING else ""
    return f"{_number(row.waiting)}{size}"


def _late(seconds: float) -> str:
    return _BAD if seconds > _VERY_LATE_S else _WARN if seconds > _LATE_S else ""


def _sparks(values: Sequence[float], highest: float) -> str:
    """The last values as a small bar chart; what is not known is a gap."""
    known = values[-_SPARK_CELLS:]
    top = len(_SPARKS) - 1
    bars = [_SPARKS[max(1, round(top * x / highest))] if highest > 0 and x == x and x >= 0 else " " for x in known]
    return "".join(bars).rjust(_SPARK_CELLS)


def _number(value: float, digits: int = 0) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def _seconds(value: float) -> str:
    if math.isnan(value):
        return "–"
    return f"{value:.1f} s" if value >= 0.9995 else f"{value * 1e3:.{0 if value >= 0.00995 else 1}f} ms"


def _bytes(value: float) -> str:
    if math.isnan(value):
        return "–"
    for unit in ("B", "kB", "MB"):
        if value < 999.5:
            return f"{value:.0f} {unit}" if unit == "B" or value >= 99.5 else f"{value:.1f} {unit}"
        value /= 1000.0
    return f"{value:.1f} GB"
