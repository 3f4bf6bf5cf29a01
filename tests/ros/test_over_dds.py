"""yard1 over DDS: its messages published by one process, the agent in a second, whoever listens to it in a third."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from splitslam import se3
from splitslam.tum import read_tum
from tests import tolerances as bars
from tests.ros.dds import DOMAIN, cyclonedds_uri
from tests.ros.heard import Heard
from tests.ros.live_run import LiveRun, live_run

SECONDS = 9.0
SCANS = 89  # of yard1 within that time
T_BODY_LIDAR = se3.compose(se3.so3_exp(np.array([0.0, 0.1, 0.3])), np.array([0.2, 0.1, 0.5]))


@pytest.fixture(scope="module")
def over_dds(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[LiveRun, Heard]:
    folder = tmp_path_factory.mktemp("dds")
    bag = shared_data / "yard1" / "yard1.bag"
    robot = folder / "robot.yaml"
    robot.write_text(bag.with_suffix(".yaml").read_text() + f"T_body_lidar: {T_BODY_LIDAR.tolist()}\n")
    graph = {"via": "cyclonedds", "domain_id": DOMAIN}
    agent = {"robot": str(robot), "source": {"ros2": {**graph, "end_after_s": 1.5}}, "ros": {"rate_hz": 50}}
    player = [sys.executable, "-m", "tests.ros.play_dds", str(bag), str(SECONDS), str(DOMAIN)]
    listener = [sys.executable, "-m", "tests.ros.listen", "ros2", json.dumps(graph)]
    environment = os.environ | {"CYCLONEDDS_URI": cyclonedds_uri()}
    run = live_run(folder, agent, player, listener, environment)
    return run, Heard.read(run.heard)


def test_no_scan_is_lost_on_the_way(over_dds: tuple[LiveRun, Heard]):
    run, _ = over_dds
    played = json.loads(run.played)
    scans = played["/velodyne_packets"]
    assert scans >= SCANS
    assert run.report["scans"] == {"read": scans, "sent": scans, "mapped": scans, "dropped": 0}
    assert {k: v for k, v in run.report["dropped_by_reason"].items() if v} == {}


def test_the_trajectory_is_as_good_as_from_the_file(over_dds: tuple[LiveRun, Heard], shared_data: Path):
    run, _ = over_dds
    assert run.evaluation(shared_data / "yard1" / "yard1.tum").ate_m <= bars.LIVE_ROS_ATE_M


def test_the_tree_of_frames_is_rep_105s(over_dds: tuple[LiveRun, Heard]):
    over_dds[1].check_tree()


def test_odometry_agrees_with_the_tree_and_its_twist_with_its_poses(over_dds: tuple[LiveRun, Heard]):
    over_dds[1].check_odometry()


def test_the_tree_leads_to_where_the_lidar_was(over_dds: tuple[LiveRun, Heard], shared_data: Path):
    truth = read_tum(shared_data / "yard1" / "yard1.tum")
    assert over_dds[1].largest_from_m(truth, T_BODY_LIDAR) <= bars.LIVE_ROS_TF_M


def test_diagnostics_end_with_a_stop_and_say_before_that_it_tracks(over_dds: tuple[LiveRun, Heard]):
    said = [(message["message"], message["level"]) for message in over_dds[1].diagnostics]
    assert ("tracking", 0) in said
    assert said[-1] == ("stopped", 1)
