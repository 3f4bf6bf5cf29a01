"""`splitslam sim`: what is asked for is what is made, to the byte."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Reader
from typer.testing import CliRunner

from splitslam.cli import app
from splitslam.errors import InputError
from splitslam.robot import load_robot
from splitslam.sim import DRIVES
from splitslam.sim.command import drive_spec
from splitslam.sim.faults import FAULTS
from splitslam.tum import read_tum

OF_A_DRIVE = ("bag", "imu_truth.tum", "tum", "yaml")


def _sim(*arguments: object) -> str:
    result = CliRunner().invoke(app, ["sim", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


def test_the_list_names_every_drive_and_every_perturbation() -> None:
    lines = [line.split() for line in _sim("--list").splitlines()]
    named = {words[0] for words in lines if words}
    assert named >= set(DRIVES) | set(FAULTS)


def test_the_same_arguments_give_the_same_bytes_and_another_seed_does_not(tmp_path: Path) -> None:
    for out, seed in (("a", 1), ("b", 1), ("c", 2)):
        shown = _sim("campus", "--out", tmp_path / out, "--seconds", 1, "--perturb", "middle", "--seed", seed)
        assert [Path(line).name for line in sorted(shown.splitlines())] == [f"campus.{kind}" for kind in OF_A_DRIVE]
    one, again, other = (
        {path.name: path.read_bytes() for path in sorted((tmp_path / out).iterdir())} for out in ("a", "b", "c")
    )
    assert one == again
    assert [name for name in one if one[name] != other[name]] == ["campus.bag", "campus.yaml"], "the truth is the same"


def test_options_say_which_sensors_there_are(tmp_path: Path) -> None:
    _sim("street", "--out", tmp_path, "--seconds", 1, "--no-gnss", "--perturb", "imu-rate=100")
    with Reader(tmp_path / "street.bag") as bag:
        topics = {c.topic: c.msgcount for c in bag.connections}
    assert topics == {"/velodyne_packets": 10, "/imu/data": 103}
    robot = load_robot(tmp_path / "street.yaml")
    assert robot.gnss is None
    assert robot.imu is not None
    assert robot.imu.rate_hz == 100.0


def test_the_dense_truth_agrees_with_that_of_the_scans(tmp_path: Path) -> None:
    _sim("park", "--out", tmp_path, "--seconds", 4)
    scans, dense = read_tum(tmp_path / "park.tum"), read_tum(tmp_path / "park.imu_truth.tum")
    assert set(np.diff(dense.stamps_ns)) == {10_000_000}
    for axis in range(3):
        between = np.interp(scans.stamps_ns, dense.stamps_ns, dense.positions_m[:, axis])
        np.testing.assert_allclose(scans.positions_m[:, axis], between, atol=1e-4)


def test_wheels_are_for_vehicles() -> None:
    asked = {"seed": 1, "perturb": "none", "seconds": None, "gnss": True}
    assert drive_spec("street", wheels=True, **asked).wheels is not None
    with pytest.raises(InputError, match="park is on foot"):
        drive_spec("park", wheels=True, **asked)
