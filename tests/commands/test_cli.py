"""The command as a process: exit codes, one line on stderr, signals."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest import mock

import pytest
import typer

from splitslam.program import call, program
from splitslam.run.options import RunOptions
from tests.commands import fakes
from tests.conftest import ROOT
from tests.typed import typed


def splitslam(*arguments: object, fake: tuple[str, str] | None = None, **environment: str) -> subprocess.Popen[str]:
    program = ("splitslam.cli",) if fake is None else ("tests.commands.with_fakes", *fake)
    return subprocess.Popen(
        [sys.executable, "-m", *program, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env=os.environ | environment,
    )


def finished(*arguments: object, fake: tuple[str, str] | None = None) -> tuple[int, str, str]:
    with splitslam(*arguments, fake=fake) as process:
        out, err = process.communicate(timeout=200)
        return process.returncode, out, err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["evil"], "splitslam: No such command 'evil'"),
        (["eval"], "splitslam eval: Missing argument 'ESTIMATE.tum'"),
        (["eval", "a.tum", "--truht", "b.tum"], "splitslam eval: No such option: --truht"),
        (
            ["eval", "a.tum", "--truth", "b.tum"],
            "a.tum: expected a trajectory in TUM format (No such file or directory)",
        ),
        (["run", "a.bag", "--out", "b"], "splitslam run: Missing option '--robot'"),
        (["run", "a.bag", "--robot", "c", "--out", "b", "--max-scans", "many"], "'--max-scans'"),
        (["run", "a.bag", "--robot", "c", "--out", "b"], "a.bag: expected a recording"),
        (["demo", "--seconds", "1"], "--seconds: expected at least 5, found 1"),
        (["sim"], "splitslam sim: expected a drive"),
        (["sim", "moon"], "drive 'moon' is not known: expected one of campus,"),
        (["sim", "campus", "--perturb", "rain"], "--perturb: 'rain' is not known: expected none, middle or people,"),
        (["sim", "campus", "--perturb", "people=some"], "--perturb: people=some: expected a number of people"),
        (["sim", "campus", "--seconds", "4000"], "--seconds: expected 1 to"),
        (["sim", "campus", "--out", "/proc/nowhere"], "--out /proc/nowhere: expected a folder that can be written"),
        (["demo", "--picture", "/nowhere/a.png"], "--picture /nowhere/a.png: expected a file in a folder that exists"),
    ],
)
def test_bad_input_is_one_line_on_stderr_and_exit_code_2(arguments: list[str], expected: str):
    exit_code, out, err = typed("splitslam", *arguments)
    assert (exit_code, out) == (2, "")
    assert expected in err
    assert err.count("\n") == 1


def test_the_process_says_it_too():
    assert finished("evil") == typed("splitslam", "evil")


def test_help_is_there_before_numba_and_gtsam_are():
    code = (
        "import sys; from splitslam import cli; print(sorted({'numba', 'gtsam', 'numpy', 'grpc'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"
    exit_code, out, _ = finished("--help")
    assert exit_code == 0
    assert all(command in out for command in ("run", "eval", "demo"))


def test_eval_prints_the_keys_of_the_conventions(tmp_path: Path):
    path = tmp_path / "a.tum"
    path.write_text(fakes.tum_lines(0.0))
    exit_code, out, err = finished("eval", path, "--truth", path, "--json")
    assert (exit_code, err) == (0, "")
    score = json.loads(out)
    assert list(score) == ["n", "outside", "ate_m", "max_m", "rpe_1s_m", "rpe_10m_m", "end_m"]
    assert score["rpe_1s_m"] is None
    exit_code, out, _ = finished("eval", path, "--truth", path)
    assert exit_code == 0
    assert "ATE" in out
    assert "run too short" in out


def test_a_program_without_arguments_shows_its_help_and_no_mistake():
    exit_code, out, err = finished()
    assert exit_code == 2
    assert "Usage: splitslam" in out + err
    assert "(see `splitslam --help`)" not in err


@pytest.mark.parametrize(("name", "said"), [("/x/map.ply", "/x/map.ply"), (None, "map-service")])
def test_a_full_disk_is_one_line_of_every_program(
    name: str | None, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def app(number: int) -> typer.Typer:
        made = program("map-service", "")

        @made.command()
        def write() -> None:
            raise OSError(number, os.strerror(number), name)

        return made

    with (
        mock.patch.object(sys, "argv", ["map-service", "write"]),
        pytest.raises(SystemExit, match="1"),
    ):
        call(app(errno.ENOSPC), "map-service")
    assert capsys.readouterr().err == f"{said}: No space left on device\n"
    with mock.patch.object(sys, "argv", ["map-service", "write"]), pytest.raises(OSError, match="Bad file"):
        call(app(errno.EBADF), "map-service")  # a defect keeps its traceback


def run_arguments(options: RunOptions) -> list[object]:
    return ["run", options.recording, "--robot", options.robot, "--out", options.out]


def test_run_prints_key_figures_and_where_the_page_is(options: RunOptions):
    exit_code, out, err = finished(*run_arguments(options), fake=("good", "good"))
    assert exit_code == 0
    assert err == "lidar.topic: /points chosen\n"
    assert "12 of 13 (1 dropped)" in out
    assert "dropped: 1 x nan" in out
    assert "lost in 3 scans: `splitslam check` tells whether the robot file is wrong" in out
    assert out.splitlines()[-1].strip() == str(options.out / "report.html")


def test_run_with_json_prints_nothing_but_the_report(options: RunOptions):
    exit_code, out, _ = finished(*run_arguments(options), "--json", fake=("good", "good"))
    assert exit_code == 0
    assert json.loads(out) == json.loads((options.out / "report.json").read_text())


def test_the_agents_line_and_exit_code_come_through(options: RunOptions):
    exit_code, out, err = finished(*run_arguments(options), fake=("note_then_bad_input", "good"))
    assert (exit_code, out, err) == (2, "", "127.0.0.1:1: expected a map service there\n")


@pytest.mark.parametrize(
    ("number", "expected"), [(signal.SIGINT, 130), (signal.SIGTERM, 130), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_both_programs_end_with_the_command_however_it_is_ended(
    options: RunOptions, tmp_path: Path, number: signal.Signals, expected: int
):
    pids = tmp_path / "pids"
    pids.mkdir()
    with splitslam(*run_arguments(options), fake=("hang", "good"), FAKE_PIDS=str(pids)) as process:
        _wait_for(lambda: len(list(pids.iterdir())) == 2)
        time.sleep(0.3)
        process.send_signal(number)
        _, err = process.communicate(timeout=100)
    assert process.returncode == expected
    _wait_for(lambda: not any(_runs(int(path.read_text())) for path in pids.iterdir()))
    assert not options.out.exists()
    if number != signal.SIGKILL:
        assert err.splitlines()[-1] == "interrupted"
        assert not list(tmp_path.glob(".splitslam-*"))


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _wait_for(condition) -> None:
    deadline_s = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline_s, "waited in vain"
        time.sleep(0.02)


def test_the_demo_writes_its_recording_its_truth_and_all_results(tmp_path: Path):
    out = tmp_path / "demo"
    exit_code, shown, _ = finished("demo", "--seconds", "5", "--out", out, fake=("good", "good"))
    assert exit_code == 0
    assert {"demo.bag", "demo.yaml", "demo.tum", "trajectory.tum", "map.ply", "report.html"} <= {
        path.name for path in out.iterdir()
    }
    assert "ATE" in shown
