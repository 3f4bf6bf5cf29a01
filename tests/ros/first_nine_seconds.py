"""The first nine seconds of yard1 in a graph: the robot that drives them, and what must have come of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splitslam import se3
from tests import tolerances as bars
from tests.ros.heard import Heard
from tests.ros.live_run import LiveRun

SECONDS = 9.0
SILENT_S = 5.0  # then all has been played: on a busy machine the player itself may falter
SCANS = 89  # of yard1 within that time
T_BODY_LIDAR = se3.compose(se3.so3_exp(np.array([0.0, 0.1, 0.3])), np.array([0.2, 0.1, 0.5]))


def robot_file(folder: Path, bag: Path) -> Path:
    """That of the recording, with the LiDAR somewhere on a body."""
    path = folder / "robot.yaml"
    path.write_text(bag.with_suffix(".yaml").read_text() + f"T_body_lidar: {T_BODY_LIDAR.tolist()}\n")
    return path


# On a busy machine the agent may be ready when all has been played, and have done with it within a second.
OFTEN = {"diagnostics_hz": 10.0}


def check(run: LiveRun, scans: int, truth: Path) -> None:
    """Nothing is lost, the map is as good as from the file, and a second process has heard what REP-105 wants."""
    assert scans >= SCANS
    assert run.report["scans"] == {"read": scans, "sent": scans, "mapped": scans, "dropped": 0}
    assert {k: v for k, v in run.report["dropped_by_reason"].items() if v} == {}
    assert run.evaluation(truth).ate_m <= bars.LIVE_ROS_ATE_M
    heard = Heard.read(run.heard)
    heard.check_tree()
    heard.check_odometry()
    heard.check_place(run.out, T_BODY_LIDAR)
    said = [(message["message"], message["level"]) for message in heard.diagnostics]
    assert ("tracking", 0) in said
    assert said[-1] == ("stopped", 1)
