"""yard1 through ROS 1: a real roscore, `rosbag play` at the recording's own pace, the agent, and a listener."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from tests.ros.first_nine_seconds import OFTEN, SECONDS, SILENT_S, check, robot_file
from tests.ros.live_run import live_run
from tests.ros.ros1 import plain_copy, roscore


def test_yard1_through_ros1_loses_nothing_is_as_good_as_from_the_file_and_comes_out_as_rep_105_has_it(
    shared_data: Path, tmp_path: Path
):
    bag, copy = shared_data / "yard1" / "yard1.bag", tmp_path / "yard1.bag"
    scans = plain_copy(bag, copy, SECONDS)
    with roscore(tmp_path) as ros:
        graph = {"master": ros.uri, "python_path": ros.python_path}
        source = {"ros1": {**graph, "end_after_s": SILENT_S}}
        agent = {"robot": str(robot_file(tmp_path, bag)), "source": source, "ros": OFTEN}
        listener = [sys.executable, "-m", "tests.ros.listen", "ros1", json.dumps({**graph, "node": "listener"})]
        run = live_run(tmp_path, agent, ros.rosbag_play(copy), listener, ros.ours, ros.environment)
    check(run, scans, bag.with_suffix(".tum"))
