"""`splitslam demo --chaos`: what it is asked for, what it shows, and how it adds up."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rich.style import Style

from splitslam.chaos.canvas import Canvas
from splitslam.chaos.result import ChaosResult, FaultResult, RobotResult, Seen, fault_result
from splitslam.chaos.script import DEFAULT, Harm, parse
from splitslam.chaos.show import Inflicted
from splitslam.chaos.table import tables
from splitslam.chaos.view import WIDTH, PartRow, RobotRow, Snapshot, render
from splitslam.errors import InputError
from tests.e2e.commands import splitslam

WAY = tuple((float(x), 5.0 * np.sin(x)) for x in np.linspace(-5, 5, 50))


def shown(renderable) -> str:
    console = Console(width=WIDTH, file=io.StringIO())
    console.print(renderable)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def robot(name: str, **changes) -> RobotRow:
    values = {"up": True, "state": 2, "place_m": (1.0, 2.0), "trail_m": WAY[:5], "gap_s": 0.0}
    values |= {"longest_gap_s": 0.3, "spool": 7, "answered": 123, "cut": False}
    return RobotRow(name=name, **(values | changes))


def test_a_script_is_read_in_order_of_time_with_its_defaults():
    harms = parse("20 cut network\n# later\n 5 kill store 2.5 # soon", "x")
    assert harms == (Harm(5.0, "kill store", 2.5), Harm(20.0, "cut network", 6.0))
    assert len(parse(DEFAULT, "default")) == 4


@pytest.mark.parametrize("line", ["5 kill dinosaur", "soon kill store", "5 kill store long", "-1 kill store", "5 kill"])
def test_a_line_that_cannot_be_meant_is_named_with_what_was_expected(line: str):
    with pytest.raises(InputError, match=r"x:2: expected"):
        parse(f"1 kill agent\n{line}", "x")


def test_the_command_says_in_one_line_what_it_cannot_do(tmp_path):
    script = tmp_path / "script"
    script.write_text("50 kill store\n")
    for options, expected in (
        (("--script", "default"), "--script: expected with --chaos"),
        (("--chaos", "--script", str(tmp_path / "none")), "expected `default` or a text file"),
        (("--chaos", "--script", str(script)), "expected everything within the 40 s of the drive, found 50"),
    ):
        result = splitslam("demo", "--out", str(tmp_path / "out"), *options)
        assert result.returncode == 2
        assert expected in result.stderr
        assert len(result.stderr.splitlines()) == 1


def test_the_view_shows_every_robot_every_part_and_what_was_done():
    rows = (robot("robot-1"), robot("robot-2", up=False), robot("robot-3", cut=True, gap_s=2.5, spool=31))
    parts = (PartRow("replica-1", "up", "2 robots, 300 scans mapped"), PartRow("PostgreSQL", "dead", ""))
    screen = shown(render(Snapshot(12.0, 40.0, rows, parts, WAY, ((4.0, "replica-1 killed"),), True)))
    for text in (
        "12.0 of 40 s",
        "● robot-1",
        "tracking",
        "agent dead",
        "cut off",
        "2.5 s",
        "replica-1 killed",
        "● dead",
    ):
        assert text in screen
    assert max(map(len, screen.splitlines())) == WIDTH


def test_a_drawing_is_to_scale_and_keeps_to_its_frame():
    canvas = Canvas(10, 5, [(0.0, 0.0), (4.0, 2.0)])
    canvas.dot(0.0, 0.0, Style())
    canvas.dot(4.0, 2.0, Style())
    canvas.dot(400.0, 2.0, Style())
    canvas.mark(2.0, 1.0, "R", Style())
    drawn = canvas.text().plain.splitlines()
    dots = [(row, column) for row, line in enumerate(drawn) for column, c in enumerate(line) if ord(c) >= 0x2801]
    assert len(dots) == 2
    (top, right), (bottom, left) = dots
    assert top < bottom
    assert left < right
    assert drawn[2][5] == "R"


def test_a_gap_belongs_to_the_fault_that_it_touches():
    answers_s = np.array([1.0, 1.1, 1.2, 4.2, 4.3, 9.0, 9.1])
    seen = Seen(answers_s, np.array([1.0, 3.0, 5.5, 8.0]), np.array([0.01, 0.2, 0.1, 0.9]))
    first = fault_result(Inflicted("store killed", 1.25, 4.0), [seen])
    assert (first.gap_s, first.drift_m) == (pytest.approx(3.0), 0.2)
    assert fault_result(Inflicted("network cut", 5.0, 6.0), [seen]).gap_s == pytest.approx(4.7)


def test_the_end_table_says_what_was_lost():
    rows = RobotResult("robot-1", 400, 397, 1, 0, 2, 0, 1.5, 0.004, 0.003, 0.001)
    screen = shown(tables(ChaosResult((rows,), (FaultResult("store killed", 9.0, 3.2, 1.5, 0.05),))))
    for text in ("2 lost", "397 scans mapped", "store killed", "50.0 mm", "1.50 s"):
        assert text in screen


@pytest.mark.parametrize("changes", [{"lost": 1}, {"twice": 1}, {"ate_m": 0.104}, {"ate_m": np.nan}])
def test_a_demo_with_a_scan_lost_or_a_trajectory_bent_has_not_passed(changes: dict[str, float]):
    good = RobotResult("robot-1", 400, 397, 1, 0, 0, 0, 1.5, 0.004, 0.003, 0.001)
    bad = replace(good, robot="robot-2", **changes)
    assert ChaosResult((good,), ()).passed
    assert not ChaosResult((good, bad), ()).passed
    assert ("bent: the trajectory of robot-2" in shown(tables(ChaosResult((good, bad), ())))) == ("ate_m" in changes)


def test_the_drives_differ_and_are_made_of_the_same_lap():
    from splitslam.chaos.drives import specs

    made = specs(40.0, seed=3)
    assert len({spec.path.waypoints_m for spec in made}) == 4
    assert len({frozenset(spec.path.waypoints_m) for spec in made}) == 1
    assert [spec.seed for spec in made] == [3, 4, 5, 6]
    assert Path(made[0].name).name == "robot-1"
