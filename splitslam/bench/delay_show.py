"""The delay experiment on the terminal, and as a picture."""

from __future__ import annotations

from matplotlib.figure import Figure
from rich.console import Console

from splitslam.bench.delay import Delayed, DelayResult
from splitslam.bench.figures_table import figures_table
from splitslam.report.style import BLUE, GREEN, LIGHT_BLUE, MUTED, ORANGE, png, styled

_COLOURS = (BLUE, GREEN, ORANGE, MUTED, LIGHT_BLUE)
_WIDTH = 100


def show(result: DelayResult, console: Console | None = None) -> None:
    """One row a run."""
    console = console or Console(highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    where = "at IMU rate" if result.at_imu_rate else "at scans"
    title = f"{result.name}, {result.scans} scans: the robot's pose {where} while answers are late"
    errors = ("ATE, robot\nmm", "to the\nfirst", "largest\nmm", "RPE 1 s\nmm", "ATE, answers\nmm")
    table = figures_table(title, "answers\nlate by", *errors, "edge odometry\ns")
    for run in result.runs:
        rpe = run.robot.rpe_1s_m
        table.add_row(
            _name(run),
            f"{run.robot.ate_m * 1e3:.1f}",
            f"{result.ratio(run):.2f}",
            f"{run.robot.max_m * 1e3:.1f}",
            "-" if rpe is None else f"{rpe * 1e3:.1f}",
            f"{run.answers.ate_m * 1e3:.1f}",
            f"{run.alone_s:.1f}" if run.odometry else "off",
        )
    console.print(table)
    if result.own_truth:
        console.print("No truth: held against the optimised trajectory of the first run.", style="dim")


def draw(result: DelayResult) -> bytes:
    """A PNG: errors against the delay, and over time."""
    with styled():
        figure = Figure(figsize=(11.0, 3.6), layout="constrained")
        by_delay, over_time = figure.subplots(1, 2, width_ratios=(1.0, 1.6))
        on = [run for run in result.runs if run.odometry]
        delays = [run.delay_ms for run in on]
        by_delay.plot(delays, [run.robot.ate_m * 1e3 for run in on], "o-", color=BLUE, label="the robot's pose")
        by_delay.plot(delays, [run.answers.ate_m * 1e3 for run in on], "s--", color=GREEN, label="the answers")
        off = [run for run in result.runs if not run.odometry]
        if off:
            at = ([run.delay_ms for run in off], [run.robot.ate_m * 1e3 for run in off])
            by_delay.plot(*at, "x", color=ORANGE, label="the robot's, without edge odometry")
        by_delay.set(xlabel="answers late by (ms)", ylabel="ATE (mm)", title=result.name, ylim=(0, None))
        by_delay.legend()
        for run, colour in zip(result.runs, _COLOURS * len(result.runs), strict=False):
            over_time.plot(run.seconds, run.error_m * 1e3, color=colour, lw=1.0, label=_name(run))
        over_time.set(xlabel="s", ylabel="error of the robot's pose (mm)", title="at scans", ylim=(0, None))
        over_time.legend()
        return png(figure, dpi=110)


def _name(run: Delayed) -> str:
    return f"{run.delay_ms:g} ms" + ("" if run.odometry else ", Imu node alone")
