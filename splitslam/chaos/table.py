"""The end of a chaos demo on the terminal: what was done and what it cost."""

from __future__ import annotations

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from splitslam.chaos.result import ChaosResult


def tables(result: ChaosResult) -> RenderableType:
    """Two tables and a line that says what was lost."""
    return Group(_faults(result), _robots(result), _verdict(result))


def show(result: ChaosResult) -> None:
    """On stdout."""
    Console().print(tables(result))


def _faults(result: ChaosResult) -> Table:
    table = Table("done to it", "at", "for", "longest gap", "drift")
    for column in table.columns[1:]:
        column.justify = "right"
    for fault in result.faults:
        lasted = f"{fault.lasted_s:.1f} s" if fault.lasted_s > 0.5 else ""
        table.add_row(fault.fault, f"{fault.at_s:.1f} s", lasted, f"{fault.gap_s:.2f} s", _mm(fault.drift_m))
    return table


def _robots(result: ChaosResult) -> Table:
    table = Table("robot", "scans", "mapped", "lost", "unseen", "longest gap", "ATE", "undisturbed")
    for column in table.columns[1:]:
        column.justify = "right"
    for robot in result.robots:
        gap, unseen = f"{robot.longest_gap_s:.2f} s", str(robot.unseen or "")
        errors = _mm(robot.ate_m), _mm(robot.ate_undisturbed_m)
        table.add_row(robot.robot, str(robot.due), str(robot.mapped), str(robot.lost), unseen, gap, *errors)
    return table


def _verdict(result: ChaosResult) -> Text:
    lost, twice = (sum(getattr(robot, name) for robot in result.robots) for name in ("lost", "twice"))
    dropped, mapped = (sum(getattr(robot, name) for robot in result.robots) for name in ("dropped", "mapped"))
    text = f"{mapped} scans mapped, {lost} lost, {twice} mapped twice, {dropped} dropped by the robots"
    if off := [robot.robot for robot in result.robots if robot.off]:
        text += f"; bent: the trajectory of {', '.join(off)}"
    return Text(text, "bold #90e06d" if result.passed else "bold #ff6b6b")


def _mm(value_m: float) -> str:
    return f"{value_m * 1e3:.1f} mm"
