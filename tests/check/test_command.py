"""The command on real and made recordings: exit codes, lines, and what the JSON holds."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from splitslam import se3
from tests import tolerances
from tests.conftest import ROOT
from tests.typed import typed

MIRRORED = {"point_times": "mirrored"}
Answer = tuple[int, dict[str, Any], str]


def check(recording: Path, robot: Path, *options: str) -> Answer:
    exit_code, out, err = typed("splitslam", "check", recording, "--robot", robot, "--json", *options)
    return exit_code, json.loads(out) if out else {}, err


def changed(robot: Path, folder: Path, **sections: Any) -> Path:
    """The robot file with keys of some sections replaced."""
    data = yaml.safe_load(robot.read_text())
    for name, values in sections.items():
        data[name] = {**data[name], **values} if isinstance(values, dict) else values
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def problem_keys(answer: dict[str, Any]) -> list[str]:
    return [f["where"] for f in answer["findings"] if f["severity"] == "problem"]


def _keys(value: Any) -> set[str]:
    if isinstance(value, list):
        return set().union(*map(_keys, value))
    if isinstance(value, dict):
        return set(value).union(*map(_keys, value.values()))
    return set()


def test_yard1_has_no_problem_and_its_row_of_table_i(shared_data: Path) -> None:
    recording = shared_data / "yard1" / "yard1.bag"
    code, answer, _ = check(recording, recording.with_suffix(".yaml"), "--seconds", "1000")
    assert (code, answer["ok"], answer["findings"]) == (0, True, [])
    row = answer["table_1"]
    assert row["scans"] == 749
    assert row["path_m"] == pytest.approx(96, abs=2)
    assert row["max_rotation_degps"] == pytest.approx(131, abs=2)
    assert row["elevation_change_m"] < 0.3
    assert answer["T_lidar_imu"]["angle_deg"] < tolerances.CHECK_ROTATION_DEG
    assert abs(answer["time_offset"]["found_ms"]) < 2 * tolerances.CHECK_DELAY_S * 1e3
    documented = set(re.findall(r"[a-z_A-Z0-9]+", (ROOT / "docs/check.md").read_text().partition("## JSON")[2]))
    assert not _keys(answer) - documented - {"lidar", "imu", "gnss"}


def test_a_robot_file_without_the_mounting_is_told_what_to_write(shared_data: Path, tmp_path: Path) -> None:
    recording = shared_data / "yard1" / "yard1.bag"
    data = yaml.safe_load(recording.with_suffix(".yaml").read_text())
    T_lidar_imu = np.array(data.pop("T_lidar_imu"))
    robot = tmp_path / "robot.yaml"
    robot.write_text(yaml.safe_dump(data))
    code, answer, err = check(recording, robot, "--seconds", "20")
    assert (code, err) == (1, "")
    assert answer["findings"][0]["what"] == "not given"
    found = np.array(answer["T_lidar_imu"]["rotation"])
    off_rad = np.linalg.norm(se3.so3_log(found.T @ T_lidar_imu[:3, :3]))
    assert np.degrees(off_rad) < 3 * tolerances.CHECK_ROTATION_DEG


def test_point_times_that_run_backwards_are_the_only_problem_of_a_car_with_a_10_hz_imu(shared_data: Path) -> None:
    recording = shared_data / "kitti_0005" / "kitti_0005_ring16.bag"
    code, answer, _ = check(recording, recording.with_suffix(".yaml"))
    assert (code, problem_keys(answer)) == (1, ["lidar.point_times"])
    assert answer["point_times"]["share"] == pytest.approx(-1.0, abs=3 * tolerances.CHECK_POINT_TIMES)
    assert answer["table_1"]["path_m"] == pytest.approx(71, abs=2)


def test_the_same_car_has_no_problem_once_its_point_times_are_mirrored(shared_data: Path, tmp_path: Path) -> None:
    recording = shared_data / "kitti_0005" / "kitti_0005_ring16.bag"
    code, answer, _ = check(recording, changed(recording.with_suffix(".yaml"), tmp_path, lidar=MIRRORED))
    assert (code, problem_keys(answer)) == (0, [])
    assert answer["point_times"]["share"] == pytest.approx(1.0, abs=3 * tolerances.CHECK_POINT_TIMES)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mounting_off_by_five_degrees_is_found_in_the_car(axis: int, shared_data: Path, tmp_path: Path) -> None:
    recording = shared_data / "kitti_0005" / "kitti_0005_ring16.bag"
    robot = recording.with_suffix(".yaml")
    T = np.array(yaml.safe_load(robot.read_text())["T_lidar_imu"])
    T[:3, :3] = se3.so3_exp(np.radians(5.0) * np.eye(3)[axis]) @ T[:3, :3]
    code, answer, _ = check(recording, changed(robot, tmp_path, lidar=MIRRORED, T_lidar_imu=T.tolist()))
    assert (code, problem_keys(answer)) == (1, ["T_lidar_imu"])


def test_several_mistakes_are_a_line_each(shared_data: Path, tmp_path: Path) -> None:
    recording = shared_data / "yard1" / "yard1.bag"
    robot = changed(
        recording.with_suffix(".yaml"),
        tmp_path,
        imu={"topic": "/imu", "rate_hz": 100, "time_offset_ns": 15_000_000},
        lidar={"columns": 900, "beam_elevations_deg": [15.0 - 2 * k for k in range(16)]},
        T_lidar_imu=np.eye(4).tolist(),
    )
    code, answer, _ = check(recording, robot, "--seconds", "25")
    assert code == 1
    assert sorted(problem_keys(answer)) == [
        "T_lidar_imu",
        "imu.rate_hz",
        "imu.time_offset_ns",
        "imu.topic",
        "lidar.beam_elevations_deg",
        "lidar.columns",
    ]
    beams = next(f for f in answer["findings"] if f["where"] == "lidar.beam_elevations_deg")
    assert "highest" in beams["what"] or "lowest" in beams["what"]
    rotation = np.array(answer["T_lidar_imu"]["rotation"])
    true = np.array(yaml.safe_load(recording.with_suffix(".yaml").read_text())["T_lidar_imu"])[:3, :3]
    assert np.degrees(se3.angle(rotation @ true.T)) < 2 * tolerances.CHECK_ROTATION_DEG


def test_for_people_each_problem_is_one_line_on_stdout(shared_data: Path, tmp_path: Path) -> None:
    recording = shared_data / "yard1" / "yard1.bag"
    robot = changed(recording.with_suffix(".yaml"), tmp_path, lidar={"model": "hdl32", "rings": 32})
    exit_code, out, _ = typed("splitslam", "check", recording, "--robot", robot, "--seconds", "6")
    assert exit_code == 1
    (line,) = [line for line in out.splitlines() if line.startswith("problem: ")]
    assert line == "problem: lidar.model: hdl32, but packets come from a vlp16; expected vlp16"
    assert "Table I" in out


@pytest.mark.parametrize(
    ("recording", "robot", "options", "expected"),
    [
        ("missing.bag", "robot.yaml", (), "missing.bag: no such recording"),
        ("robot.yaml", "robot.yaml", (), "not a recording"),
        ("robot.yaml", "none.yaml", (), "none.yaml"),
        ("robot.yaml", "robot.yaml", ("--seconds", "0"), "--seconds: expected more than 0"),
        ("robot.yaml", "robot.yaml", ("--second", "3"), "No such option"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    recording: str, robot: str, options: tuple[str, ...], expected: str, tmp_path: Path
) -> None:
    (tmp_path / "robot.yaml").write_text("robot: {id: r}\n")
    code, answer, err = check(tmp_path / recording, tmp_path / robot, *options)
    assert (code, answer) == (2, {})
    assert len(err.strip().splitlines()) == 1
    assert expected in err
