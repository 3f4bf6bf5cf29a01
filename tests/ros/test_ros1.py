"""yard1 through ROS 1: a real roscore, `rosbag play` at the recording's own pace, the agent, and a listener."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from splitslam import se3
from splitslam.tum import read_tum
from tests import tolerances as bars
from tests.ros.heard import Heard
from tests.ros.live_run import LiveRun, live_run
from tests.ros.ros1 import plain_copy, roscore

SECONDS = 9.0
SCANS = 89  # of yard1 within that time
T_BODY_LIDAR = se3.compose(se3.so3_exp(np.array([0.0, 0.1, 0.3])), np.array([0.2, 0.1, 0.5]))


@pytest.fixture(scope="module")
def through_ros1(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[LiveRun, Heard, int]:
    folder = tmp_path_factory.mktemp("ros1")
    bag = shared_data / "yard1" / "yard1.bag"
    copy = folder / "yard1.bag"
    scans = plain_copy(bag, copy, SECONDS)
    robot = folder / "robot.yaml"
    robot.write_text(bag.with_suffix(".yaml").read_text() + f"T_body_lidar: {T_BODY_LIDAR.tolist()}\n")
    with roscore(folder) as ros:
        graph = {"master": ros.uri, "python_path": ros.python_path}
        agent = {"robot": str(robot), "source": {"ros1": {**graph, "end_after_s": 1.5}}}
        listener = [sys.executable, "-m", "tests.ros.listen", "ros1", json.dumps({**graph, "node": "listener"})]
        run = live_run(folder, agent, ros.rosbag_play(copy), listener, ros.ours, ros.environment)
    return run, Heard.read(run.heard), scans


def test_no_scan_is_lost_on_the_way(through_ros1: tuple[LiveRun, Heard, int]):
    run, _, scans = through_ros1
    assert scans >= SCANS
    assert run.report["scans"] == {"read": scans, "sent": scans, "mapped": scans, "dropped": 0}
    assert {k: v for k, v in run.report["dropped_by_reason"].items() if v} == {}
    stamps_ns = np.array(run.report["stamps_ns_by_scan"])
    assert np.diff(stamps_ns).max() < 150_000_000  # none in between is missing


def test_the_trajectory_is_as_good_as_from_the_file(through_ros1: tuple[LiveRun, Heard, int], shared_data: Path):
    run = through_ros1[0]
    assert run.evaluation(shared_data / "yard1" / "yard1.tum").ate_m <= bars.LIVE_ROS_ATE_M


def test_the_tree_of_frames_is_rep_105s(through_ros1: tuple[LiveRun, Heard, int]):
    through_ros1[1].check_tree()


def test_odometry_agrees_with_the_tree_and_its_twist_with_its_poses(through_ros1: tuple[LiveRun, Heard, int]):
    through_ros1[1].check_odometry()


def test_the_tree_leads_to_where_the_lidar_was(through_ros1: tuple[LiveRun, Heard, int], shared_data: Path):
    truth = read_tum(shared_data / "yard1" / "yard1.tum")
    assert through_ros1[1].largest_from_m(truth, T_BODY_LIDAR) <= bars.LIVE_ROS_TF_M


def test_diagnostics_end_with_a_stop_and_say_before_that_it_tracks(through_ros1: tuple[LiveRun, Heard, int]):
    said = [(message["message"], message["level"]) for message in through_ros1[1].diagnostics]
    assert ("tracking", 0) in said
    assert said[-1] == ("stopped", 1)
