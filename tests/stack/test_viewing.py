"""A viewer behind the proxy sees the robots of all replicas, and goes on when they move."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from splitslam.security.client import Connector
from splitslam.security.settings import ClientTls
from splitslam.stack import Stack
from splitslam.stack.robot import LightRobot
from splitslam.view.live import LiveView
from splitslam.view.scene import Scene
from tests.stack.watch import fullest, wait_level
from tests.view.logged import Logged

pytestmark = pytest.mark.alone  # on the stack that the others have started
Drive = Callable[..., list[LightRobot]]
WAIT_S = 30.0


def test_a_viewer_sees_the_robots_of_every_replica_and_goes_on_when_one_is_drained(whole: Stack, drive: Drive) -> None:
    robots = drive(3)
    wait_level(whole, [1, 1, 1])
    logged, notes = Logged(), []
    view = LiveView(Scene(logged, voxel_m=0.0), Connector(whole.address, ClientTls()), notes.append)  # type: ignore[arg-type]

    def until(scans: int, what: str) -> None:
        """So many new scans of each robot."""
        wanted = {robot.robot_id: shown(robot) + scans for robot in robots}
        deadline_s = time.monotonic() + WAIT_S
        view.run(lambda: time.monotonic() < deadline_s and any(shown(r) < wanted[r.robot_id] for r in robots))
        assert all(shown(robot) >= wanted[robot.robot_id] for robot in robots), f"{what}: {notes}"

    def shown(robot: LightRobot) -> int:
        return len(logged.of(f"world/{robot.robot_id}/lidar"))

    try:
        until(5, "all three, each on a replica of its own")
        assert fullest(whole).drain() == 0
        until(10, "after one of them has moved")
        stamps = [entry.stamp_ns for entry in logged.of(f"world/{robots[0].robot_id}/lidar")]
        assert len(set(stamps)) == len(stamps), "no scan is shown twice"
    finally:
        view.close()
        for robot in robots:
            robot.finish()
