"""yard1 through ROS 1: a real roscore, `rosbag play` at the recording's own pace, the agent, and a listener."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from splitslam import se3
from tests import tolerances as bars
from tests.ros.heard import Heard
from tests.ros.live_run import live_run
from tests.ros.ros1 import plain_copy, roscore

SECONDS = 9.0
SCANS = 89  # of yard1 within that time
T_BODY_LIDAR = se3.compose(se3.so3_exp(np.array([0.0, 0.1, 0.3])), np.array([0.2, 0.1, 0.5]))


def test_yard1_through_ros1_loses_nothing_is_as_good_as_from_the_file_and_comes_out_as_rep_105_has_it(
    shared_data: Path, tmp_path: Path
):
    folder = tmp_path
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
    heard = Heard.read(run.heard)

    # nothing is lost on the way
    assert scans >= SCANS
    assert run.report["scans"] == {"read": scans, "sent": scans, "mapped": scans, "dropped": 0}
    assert {k: v for k, v in run.report["dropped_by_reason"].items() if v} == {}
    # and it is mapped as well as from the file
    assert run.evaluation(shared_data / "yard1" / "yard1.tum").ate_m <= bars.LIVE_ROS_ATE_M
    # what a second process has heard
    heard.check_tree()
    heard.check_odometry()
    heard.check_place(run.out, T_BODY_LIDAR)
    said = [(message["message"], message["level"]) for message in heard.diagnostics]
    assert ("tracking", 0) in said
    assert said[-1] == ("stopped", 1)
