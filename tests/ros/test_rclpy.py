"""ROS 2 by rclpy and Fast DDS, of PyPI's wheels, in a process of its own: their libraries come by its environment."""

from __future__ import annotations

import json
import os
import subprocess
import sys

from tests.conftest import ROOT
from tests.ros import ros2
from tests.ros.dds import DOMAIN
from tests.ros.through_rclpy import SAMPLES_SENT


def test_two_nodes_find_each_other_and_every_sample_cloud_and_latched_message_arrives_as_it_was_sent():
    command = (sys.executable, "-m", "tests.ros.through_rclpy", str(DOMAIN))
    environment = os.environ | ros2.environment()
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    names, imu, cloud, static, failing = map(json.loads, done.stdout.splitlines())
    assert names == {"names": [f"ROS 2 domain {DOMAIN} (rclpy)"] * 2}
    arrived = {"found": True, "own": False, "connected": True, "whole": True, "lost": {}}
    assert imu == {"topic": "/imu/data", "heard": SAMPLES_SENT, **arrived}
    assert cloud == {"topic": "/points_raw", "heard": 5, **arrived}
    assert static == {"topic": "/static", "whole": True}
    assert failing == {"topic": "/failing", "failed": True, "heard_after": True}
