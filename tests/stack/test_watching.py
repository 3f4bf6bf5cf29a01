"""Sessions that move between replicas while somebody follows them through the proxy."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable

import pytest

from splitslam.map_client import MapClient
from splitslam.stack import Stack
from splitslam.stack.robot import LightRobot
from splitslam.wire import pose_pb2 as pb
from tests import tolerances as bars
from tests.map_service.watching import Follower, kinds
from tests.stack.watch import fullest, owner, wait_level

pytestmark = pytest.mark.alone  # gaps by the clock
Drive = Callable[..., list[LightRobot]]


def gap_s(follower: Follower, since_s: float) -> float:
    """The longest time without a scan of any robot."""
    times = [at_s for message, at_s in zip(follower.messages, follower.at_s, strict=False) if message.poses]
    return max((b - a for a, b in itertools.pairwise(times) if b > since_s), default=0.0)


def told(follower: Follower, session_id: str) -> list[pb.Event]:
    return [event for event in follower.events if event.session_id == session_id]


def test_who_follows_gets_every_scan_once_while_replicas_are_killed_and_drained(whole: Stack, drive: Drive) -> None:
    robots = drive(3)
    wait_level(whole, [1, 1, 1])
    names = [robot.robot_id for robot in robots]
    with MapClient(whole.address) as client:
        follower = Follower(client.watch_poses(pb.SessionSelection(robot_ids=names), from_start=True))
        events = Follower(client.events(pb.SessionSelection(robot_ids=names), from_start=True))
        for robot in robots:
            follower.wait_seq(robot.answered, robot.session_id)
        since_s = time.monotonic()
        owners = {owner(whole, robot) for robot in robots}
        fullest(whole).kill()
        for robot in robots:
            robot.wait_answers(robot.answered + 20)
        fullest(whole).drain()
        for robot in robots:
            robot.wait_answers(robot.answered + 20)
        assert {owner(whole, robot) for robot in robots} != owners, "nobody has moved"
        for robot in robots:
            robot.finish()
            follower.wait_seq(robot.sent, robot.session_id)
            assert follower.seqs(robot.session_id) == list(range(1, robot.sent + 1))
        assert gap_s(follower, since_s) < bars.WATCH_GAP_S
        for robot in robots:  # by session: robots of these names may have driven on this stack before
            events.wait(lambda f, of=robot.session_id: "ended" in kinds(told(f, of)), f"the end of {robot.session_id}")
            assert [event.number for event in told(events, robot.session_id)] == list(
                range(1, len(told(events, robot.session_id)) + 1)
            )
        opened = [kinds(told(events, robot.session_id)).count("opened") for robot in robots]
        assert min(opened) >= 1
        assert sum(opened) > 3
