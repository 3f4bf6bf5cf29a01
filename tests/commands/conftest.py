"""A recording that is only looked at by fakes, and a robot that exists."""

from __future__ import annotations

from pathlib import Path

import pytest

from splitslam.run.options import RunOptions


@pytest.fixture
def options(tmp_path: Path) -> RunOptions:
    recording, robot = tmp_path / "drive.bag", tmp_path / "robot.yaml"
    recording.write_bytes(b"#ROSBAG V2.0\n")
    robot.write_text("robot: {id: rover}\nlidar: {model: vlp16}\nimu: null\n")
    return RunOptions(recording=recording, robot=robot, out=tmp_path / "out")
