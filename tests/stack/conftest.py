"""One stack for all of these tests: real PostgreSQL, Envoy and service processes, with the pipeline that counts."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from edge_agent.config import UplinkConfig
from splitslam.stack import Stack
from splitslam.stack.reel import Reel
from splitslam.stack.robot import LightRobot
from tests.conftest import ROOT
from tests.map_service.harness import frame, hello

FAKE = (sys.executable, "-m", "tests.map_service.fake_service")
# Looks at the store five times as often as by default, so that a test of balance takes seconds.
SETTINGS = {"replica": {"beat_s": 0.2, "rest_s": 0.4}, "limits": {"silent_s": 2.0}}
REEL = Reel(hello("-"), [frame(seq) for seq in range(1, 1001)])


@pytest.fixture(scope="session")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    folder: Path = tmp_path_factory.mktemp("stack")
    with contextlib.chdir(ROOT), Stack(folder, replicas=3, settings=SETTINGS, program=FAKE) as running:
        yield running


@pytest.fixture
def whole(stack: Stack) -> Stack:
    """With three replicas, all healthy, however the test before has left it."""
    for replica in stack.replicas:
        replica.thaw()
        if not replica.alive:
            replica.start()
    stack.wait_healthy()
    return stack


# A busy machine may take longer than the 0.5 s after which a robot tries elsewhere, and tests ask where it goes.
PATIENT = UplinkConfig(welcome_timeout_s=3.0, watchdog_s=5.0)


@pytest.fixture
def drive(whole: Stack) -> Iterator[Callable[..., list[LightRobot]]]:
    """drive(n, uplink): that many robots, each with a few answers."""
    robots: list[LightRobot] = []

    def start(count: int, uplink: UplinkConfig = PATIENT) -> list[LightRobot]:
        fresh = [LightRobot(whole.address, REEL, f"rover-{len(robots) + i}", uplink=uplink) for i in range(count)]
        robots.extend(fresh)
        for robot in fresh:
            robot.start()
        for robot in fresh:
            robot.wait_answers(10)
        return fresh

    yield start
    for robot in robots:
        robot.close()
