"""The terminal view of `splitslam demo --chaos`: one snapshot in, one screen out."""

from __future__ import annotations

from dataclasses import dataclass

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.style import Style
from rich.table import Table
from rich.text import Text

from splitslam.chaos.canvas import Canvas
from splitslam.wire.types_pb2 import TrackingState

WIDTH = 118
_MAP_COLUMNS, _MAP_ROWS = 42, 20
COLOURS = ("#4cc9f0", "#f9c74f", "#f786c8", "#90e06d")
_GOOD, _WARN, _BAD, _DIM = "#90e06d", "#f9c74f", "#ff6b6b", "#8a8f98"
_WORDS = {"up": _GOOD, "starting": _WARN, "draining": _WARN, "frozen": _BAD, "dead": _BAD, "cut": _BAD}
_EVENTS = 6

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class RobotRow:
    """One robot now. place_m: (x, y) in the yard; None: not yet known. trail_m: where it has been."""

    name: str
    up: bool
    state: int
    place_m: Point | None
    trail_m: tuple[Point, ...]
    gap_s: float
    longest_gap_s: float
    spool: int
    answered: int
    cut: bool


@dataclass(frozen=True, slots=True)
class PartRow:
    """One process of the rack now. word: up, starting, frozen, draining or dead; cut is the network's."""

    name: str
    word: str
    detail: str


@dataclass(frozen=True, slots=True)
class Snapshot:
    """All that the view shows. way_m: the lap that is driven. events: when (s of the drive) and what."""

    now_s: float
    duration_s: float
    robots: tuple[RobotRow, ...]
    parts: tuple[PartRow, ...]
    way_m: tuple[Point, ...]
    events: tuple[tuple[float, str], ...]
    keys: bool


def render(shot: Snapshot) -> RenderableType:
    """The whole screen, WIDTH columns wide."""
    left = Group(_robots(shot), _rack(shot), _events(shot))
    body = Table.grid(padding=(0, 1))
    body.add_column(width=WIDTH - _MAP_COLUMNS - 9)
    body.add_column(width=_MAP_COLUMNS + 4)
    body.add_row(left, _map(shot))
    return Panel(Group(body, _footer(shot)), title=_title(shot), width=WIDTH, border_style=_DIM, padding=(0, 1))


def _title(shot: Snapshot) -> Text:
    clock = f"{max(0.0, shot.now_s):4.1f} of {shot.duration_s:.0f} s" if shot.now_s >= 0 else "the robots get ready"
    return Text.assemble(("SplitSLAM", "bold"), ("  pull any plug  ", _DIM), clock)


def _robots(shot: Snapshot) -> RenderableType:
    table = Table(box=None, expand=True, header_style=_DIM, padding=(0, 0, 0, 1))
    table.add_column("", no_wrap=True, width=9)
    table.add_column("x, y m", no_wrap=True, justify="right", width=11)
    table.add_column("state", no_wrap=True, width=10)
    for name in ("silent", "longest", "kept", "mapped"):
        table.add_column(name, justify="right", no_wrap=True, min_width=len(name))
    for k, robot in enumerate(shot.robots):
        place = "" if robot.place_m is None else f"{robot.place_m[0]:5.1f} {robot.place_m[1]:5.1f}"
        state, colour = _state(robot)
        silent = Text(f"{robot.gap_s:.1f} s" if robot.gap_s else "", _BAD if robot.gap_s > 1.0 else _WARN)
        kept = Text(str(robot.spool), _WARN if robot.spool > 25 else "")
        name = Text(f"● {robot.name}", COLOURS[k % len(COLOURS)])
        longest = f"{robot.longest_gap_s:.1f} s" if robot.longest_gap_s else ""
        table.add_row(name, place, Text(state, colour), silent, longest, kept, str(robot.answered))
    return Panel(table, title=Text("robots", _DIM), title_align="left", border_style=_DIM, padding=(0, 0))


def _state(robot: RobotRow) -> tuple[str, str]:
    if not robot.up:
        return "agent dead", _BAD
    name = TrackingState.Name(robot.state).removeprefix("TRACKING_STATE_").lower() if robot.state else "starting"
    if robot.cut:
        return "cut off", _BAD
    return name, _GOOD if name == "tracking" else _WARN


def _rack(shot: Snapshot) -> RenderableType:
    table = Table(box=None, expand=True, show_header=False, padding=(0, 0, 0, 1))
    table.add_column(width=11, no_wrap=True)
    table.add_column(width=10, no_wrap=True)
    table.add_column(no_wrap=True)
    for part in shot.parts:
        colour = _WORDS.get(part.word, "")
        table.add_row(part.name, Text(f"● {part.word}", colour), Text(part.detail, _DIM))
    return Panel(table, title=Text("rack", _DIM), title_align="left", border_style=_DIM, padding=(0, 0))


def _map(shot: Snapshot) -> RenderableType:
    canvas = Canvas(_MAP_COLUMNS, _MAP_ROWS, shot.way_m)
    for point in shot.way_m:
        canvas.dot(*point, Style(color="#3a3f4b"))
    for k, robot in enumerate(shot.robots):
        for point in robot.trail_m:
            canvas.dot(*point, Style(color=COLOURS[k % len(COLOURS)]))
    for k, robot in enumerate(shot.robots):
        if robot.place_m is not None:
            bad = not robot.up or robot.cut
            style = Style(color="#101418", bgcolor=_BAD if bad else COLOURS[k % len(COLOURS)], bold=True)
            canvas.mark(*robot.place_m, robot.name[-1], style)
    return Panel(canvas.text(), title=Text("the yard", _DIM), title_align="left", border_style=_DIM, padding=(0, 1))


def _events(shot: Snapshot) -> RenderableType:
    last = shot.events[-_EVENTS:]
    lines = [Text(f"{at_s:5.1f}  {what}", "bold" if k + 1 == len(last) else "") for k, (at_s, what) in enumerate(last)]
    lines += [Text("")] * (_EVENTS - len(lines))
    return Panel(Group(*lines), title=Text("done to it", _DIM), title_align="left", border_style=_DIM, padding=(0, 1))


def _footer(shot: Snapshot) -> Text:
    if not shot.keys:
        return Text("the script pulls the plugs", _DIM)
    return Text("k kill a replica   s kill the store   n cut the network   a kill an agent   q quit", _DIM)
