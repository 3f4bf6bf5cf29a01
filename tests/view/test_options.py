"""`splitslam view` refuses what it cannot show in one line, before it starts anything."""

from __future__ import annotations

from pathlib import Path

import pytest

from splitslam.errors import InputError
from splitslam.view.folder import read_folder
from splitslam.view.options import ViewOptions
from tests.view.made_run import write_run

BAD = [
    ({"target": "nowhere"}, "nowhere: expected a run's folder, a .rrd file or HOST:PORT of a map service"),
    ({"target": "host:99999"}, "host:99999: expected a run's folder"),
    ({"save": Path("/nowhere/x.rrd")}, "--save /nowhere/x.rrd: expected a file in a folder that exists"),
    ({"save": Path("x.rrd"), "web": True}, "--web: expected without --save"),
    ({"memory": "lots"}, "--memory: expected a size such as 500MB, 2GiB or 25%, found 'lots'"),
    ({"voxel_m": -1.0}, "--voxel: expected 0 or 0.01 to 100 m, found -1"),
    ({"voxel_m": float("nan")}, "--voxel: expected 0 or 0.01 to 100 m, found nan"),
    ({"points": 999}, "--points: expected 0 or at least 1000, found 999"),
    ({"seconds": 0.0}, "--seconds: expected more than 0, found 0"),
]


@pytest.mark.parametrize(("asked", "said"), BAD)
def test_what_cannot_be_done_is_said_in_one_line(asked: dict, said: str) -> None:
    with pytest.raises(InputError) as caught:
        ViewOptions(**asked)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_a_recording_and_a_service_are_told_apart(tmp_path: Path) -> None:
    recording = tmp_path / "x.rrd"
    recording.touch()
    found = [ViewOptions(target) for target in (str(tmp_path), str(recording), "robot.local:50051", "[::1]:50051")]
    assert [(o.folder, o.file) for o in found] == [(tmp_path, None), (None, recording), (None, None), (None, None)]


@pytest.mark.parametrize(
    "name",
    ["report.json", "map.ply", "trajectory.tum", "online.tum", "keyframes.csv", "scans.csv", "online_covariance.csv"],
)
def test_a_damaged_file_of_a_run_is_named(tmp_path: Path, name: str) -> None:
    write_run(tmp_path)
    (tmp_path / name).write_bytes(b"1,2\n\xff garbage")
    with pytest.raises(InputError, match=name):
        read_folder(tmp_path)


@pytest.mark.parametrize("name", ["report.json", "map.ply", "trajectory.tum", "online.tum"])
def test_a_missing_file_of_a_run_is_named(tmp_path: Path, name: str) -> None:
    write_run(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(InputError, match=name):
        read_folder(tmp_path)
