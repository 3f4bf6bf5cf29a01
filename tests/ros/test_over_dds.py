"""yard1 over DDS: its messages published by one process, the agent in a second, whoever listens to it in a third."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from tests.ros.dds import DOMAIN, cyclonedds_uri
from tests.ros.first_nine_seconds import OFTEN, SECONDS, SILENT_S, check, robot_file
from tests.ros.live_run import live_run


def test_yard1_over_dds_loses_nothing_is_as_good_as_from_the_file_and_comes_out_as_rep_105_has_it(
    shared_data: Path, tmp_path: Path
):
    bag = shared_data / "yard1" / "yard1.bag"
    graph = {"via": "cyclonedds", "domain_id": DOMAIN}
    source = {"ros2": {**graph, "end_after_s": SILENT_S}}
    agent = {"robot": str(robot_file(tmp_path, bag)), "source": source, "ros": {"rate_hz": 50, **OFTEN}}
    player = [sys.executable, "-m", "tests.ros.play_dds", str(bag), str(SECONDS), str(DOMAIN)]
    listener = [sys.executable, "-m", "tests.ros.listen", "ros2", json.dumps(graph)]
    run = live_run(tmp_path, agent, player, listener, os.environ | {"CYCLONEDDS_URI": cyclonedds_uri()})
    check(run, json.loads(run.played)["/velodyne_packets"], bag.with_suffix(".tum"))
