"""A finished run's folder: its map by keyframes and its trajectories, where its files say they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from splitslam.view.folder import read_folder, show_folder
from splitslam.view.keyframe_blocks import BLOCK
from splitslam.view.scene import Scene
from tests.tolerances import VIEW_M
from tests.view import made_run
from tests.view.logged import Logged, points


@pytest.fixture
def logged(tmp_path: Path) -> Logged:
    made_run.write_run(tmp_path)
    logged = Logged()
    show_folder(read_folder(tmp_path), Scene(logged, voxel_m=0.0))  # type: ignore[arg-type]
    return logged


def test_the_map_is_the_runs_block_by_block_at_the_times_they_were_complete(logged: Logged) -> None:
    np.testing.assert_allclose(logged.map_of("rover-7"), made_run.walls(), atol=VIEW_M)
    for path in logged.paths("world/rover-7/map/"):
        (cloud,) = logged.of(path, "Points3D")
        last = min((int(path.rpartition("/")[2]) + 1) * BLOCK, made_run.SCANS // made_run.EVERY) - 1
        assert cloud.stamp_ns == made_run.START_NS + last * made_run.EVERY * made_run.STEP_NS


def test_the_corrected_way_and_the_one_as_answered_are_both_there(logged: Logged) -> None:
    way = np.concatenate(logged.way_of("rover-7"))
    expected = np.array([T[:3, 3] for T in made_run.poses()])
    off_m = np.linalg.norm(way[:, None] - expected[None], axis=2)
    assert off_m.min(axis=1).max() < VIEW_M, "nothing is drawn where the robot was not"
    assert off_m.min(axis=0).max() < VIEW_M, "and nothing of its way is left out"
    last = np.array(logged.of("world/rover-7/online/newest")[-1].fields["strips"][0])[-1]
    np.testing.assert_allclose(last - expected[-1], [made_run.OFF_M, made_run.OFF_M, 0.0], atol=VIEW_M)


def test_plots_loops_and_covariance_come_from_the_tables(logged: Logged) -> None:
    assert logged.of("uplink/rover-7/kbps")[-1].fields["scalars"] == pytest.approx([100.0])
    assert len(logged.of("latency/rover-7/round\\ trip")) == made_run.SCANS - 1
    assert len(logged.of("world/rover-7/lidar/covariance")) == made_run.SCANS
    ends = [made_run.poses()[0][:3, 3], made_run.poses()[made_run.SCANS - made_run.EVERY][:3, 3]]
    np.testing.assert_allclose(logged.of("world/rover-7/loops")[-1].fields["strips"], [ends], atol=VIEW_M)


def test_a_folder_of_an_older_release_is_shown_without_its_keyframes(tmp_path: Path) -> None:
    made_run.write_run(tmp_path)
    for name in ("keyframes.csv", "scans.csv", "online_covariance.csv"):
        (tmp_path / name).unlink()
    logged = Logged()
    show_folder(read_folder(tmp_path), Scene(logged, voxel_m=0.0))  # type: ignore[arg-type]
    np.testing.assert_allclose(
        points(logged.of("world/rover-7/map/newest/0", "Points3D")[0]), made_run.walls(), atol=VIEW_M
    )
    assert logged.paths("world/rover-7/trajectory/")
