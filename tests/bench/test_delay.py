"""`splitslam bench delay`: what it writes, and that answers 300 ms late are as good as the issue wants."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

from splitslam.bench.in_one_process import Network
from tests import tolerances as bars
from tests.typed import typed

SCANS = 150
bench = partial(typed, "splitslam", "bench", "delay")


def test_it_writes_json_and_picture_of_every_delay_and_of_the_imu_node_alone(shared_data: Path, tmp_path: Path):
    out, yard1 = tmp_path / "out", shared_data / "yard1" / "yard1.bag"
    exit_code, text, errors = bench(yard1, "--delays", "0,300,1000", "--max-scans", SCANS, "--out", out, "--json")
    assert exit_code == 0, errors
    result = json.loads(text)
    assert result == json.loads((out / "delay.json").read_text())
    assert (out / "delay.png").read_bytes().startswith(b"\x89PNG")
    runs = {(run["delay_ms"], run["edge_odometry"]): run for run in result["runs"]}
    assert list(runs) == [(0, True), (300, True), (1000, True), (1000, False)]
    assert (result["truth"], result["robot_pose_at"]) == ("given", "IMU rate")
    assert runs[0, True]["alone_s"] == runs[300, True]["alone_s"] == 0
    assert runs[1000, True]["alone_s"] > 10
    assert runs[0, True]["robot_ate_ratio"] == 1.0
    assert runs[300, True]["robot_ate_ratio"] <= bars.DELAY_300_MS_RATIO
    assert runs[1000, False]["robot"]["ate_m"] > 1.3 * runs[1000, True]["robot"]["ate_m"]
    assert runs[300, True]["robot"]["n"] > 10 * result["scans"]
    assert max(run["odom_max_m"] for run in runs.values()) <= bars.ODOM_STEP_M


def test_an_answer_is_due_after_its_delay_and_not_during_silence():
    network = Network(delay_s=0.3, silent_s=(1.0, 2.0))
    second = 1_000_000_000
    assert network.due_ns(5 * second, start_ns=5 * second) == 5_300_000_000
    assert network.due_ns(5_800_000_000, start_ns=5 * second) == 7 * second
    assert network.due_ns(6_699_999_999, start_ns=5 * second) == 7 * second
    assert network.due_ns(7 * second, start_ns=5 * second) == 7_300_000_000


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["a.bag"], "a.bag: expected a recording"),
        (["pyproject.toml", "--robot", "Makefile", "--delays", "0,x"], "--delays: expected milliseconds"),
        (["pyproject.toml"], "pyproject.yaml: expected a robot file beside the recording"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments: list[str], expected: str, tmp_path: Path):
    exit_code, out, err = bench(*arguments, "--out", tmp_path / "out")
    assert (exit_code, out) == (2, "")
    assert expected in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()
