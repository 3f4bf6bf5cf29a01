"""`splitslam bench edge`: made drives with a LiDAR of any size, and what is written about them."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from edge_agent.sources import open_recording
from splitslam.bench.edge_made import grids, made_drive
from splitslam.errors import InputError
from splitslam.robot import load_robot
from splitslam.scan import Scan
from splitslam.sim.grid_lidar import Grid
from tests.typed import typed

SMALL = Grid(24, 256)
bench = partial(typed, "splitslam", "bench", "edge")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    out = tmp_path_factory.mktemp("edge")
    exit_code, text, errors = bench("--grids", SMALL, "--seconds", 1.5, "--no-fpga", "--out", out)
    assert exit_code == 0, errors
    return out, text


def test_it_writes_json_and_picture_and_keeps_the_drive(made: tuple[Path, str]):
    out, text = made
    assert sorted(path.name for path in out.iterdir()) == ["edge.json", "edge.png", "made"]
    assert (out / "edge.png").read_bytes().startswith(b"\x89PNG")
    assert "24x256_1.5s" in text
    (one,) = json.loads((out / "edge.json").read_text())["recordings"]
    assert (one["lidar"], one["scans"]) == ("24x256", 14)  # of 15: without the first
    assert one["edge_ms"]["here_fpga"] is None
    stages = sum(stage["mean"] for stage in one["stages_cpu_ms"].values())
    assert 0 < stages <= one["edge_ms"]["here"]["mean"] + 1e-9  # the same sum in another order


def test_a_drive_that_is_there_is_not_made_again(made: tuple[Path, str]):
    bag, robot = made_drive(SMALL, 1.5, made[0] / "made")
    before = bag.stat().st_mtime_ns, robot.stat().st_mtime_ns
    assert made_drive(SMALL, 1.5, made[0] / "made") == (bag, robot)
    assert (bag.stat().st_mtime_ns, robot.stat().st_mtime_ns) == before


def test_a_grid_lidar_sees_each_cell_once_at_its_columns_time(made: tuple[Path, str]):
    bag, robot = made_drive(SMALL, 1.5, made[0] / "made")
    with open_recording(bag, load_robot(robot), max_scans=3) as recording:
        scans = [event for _, event in recording.events() if isinstance(event, Scan)]
    for scan in scans:
        assert 0.5 * SMALL.rings * SMALL.columns < len(scan) <= SMALL.rings * SMALL.columns
        column = np.rint(scan.t_offset_ns * (SMALL.columns / 1e8)).astype(int)
        assert len(np.unique(column * SMALL.rings + scan.ring)) == len(scan)
        azimuth = np.arctan2(scan.points_lidar[:, 1], scan.points_lidar[:, 0])
        turned = np.angle(np.exp(1j * (azimuth + 2 * np.pi * column / SMALL.columns)))
        np.testing.assert_allclose(turned, 0.0, atol=1e-4)
        elevation = np.degrees(np.arctan2(scan.points_lidar[:, 2], np.linalg.norm(scan.points_lidar[:, :2], axis=1)))
        np.testing.assert_allclose(elevation, SMALL.elevations_deg[scan.ring], atol=1e-3)


@pytest.mark.parametrize("text", ["64", "64x", "3x1800", "129x2048", "16x1800,axb"])
def test_a_lidar_that_cannot_be_made_is_one_clear_line(text: str):
    with pytest.raises(InputError, match="--grids: expected RINGSxCOLUMNS of 4 to 128 rings"):
        grids(text)


def test_bad_input_is_one_line_and_exit_code_2(tmp_path: Path):
    for arguments, said in (
        (["--seconds", "0.5"], "--seconds: expected 1 to 40, found 0.5"),
        (["--robot", "x.yaml"], "--robot: expected one recording with it, found 0"),
        ([tmp_path / "none.bag"], "none.bag"),
    ):
        exit_code, _, errors = bench(*arguments, "--out", tmp_path / "out")
        assert (exit_code, len(errors.strip().splitlines())) == (2, 1)
        assert said in errors
    assert not (tmp_path / "out").exists()
