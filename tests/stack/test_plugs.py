"""Whatever happens to a replica: every frame is mapped exactly once, and robots wait no longer than they must."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable

import pytest

from edge_agent.config import UplinkConfig
from splitslam.stack import Stack
from splitslam.stack.process import wait_until
from splitslam.stack.robot import LightRobot
from tests import tolerances as bars
from tests.map_service.fakes import FINAL_SHIFT_M
from tests.map_service.harness import Operator
from tests.stack.watch import events, fenced, fullest, loads, owner, rebalanced, streams, wait_level

pytestmark = pytest.mark.alone  # gaps by the clock, and who found the place at the first try
Drive = Callable[..., list[LightRobot]]
QUIET_GAP_S = 0.15  # between two answers at 10 Hz, of a machine with nothing else to do


def over_before(robot: LightRobot, before_s: float) -> float:
    """The longest time between two of its answers that came before that."""
    times = [heard.at_s for heard in robot.heard if heard.at_s < before_s]
    return max(b - a for a, b in itertools.pairwise(times))


def check_gaps(robots: list[LightRobot], since_s: float, bar_s: float) -> None:
    """bar_s: of a quiet machine, which `make chaos` holds; here its order of size.

    On a busy machine, where undisturbed answers are late too, in proportion.
    """
    undisturbed_s = max(over_before(robot, since_s) for robot in robots)
    allowed_s = bars.GAP_SLACK * bar_s * max(1.0, undisturbed_s / QUIET_GAP_S)
    assert [gap for robot in robots if (gap := robot.gap_s(since_s)) > allowed_s] == []


def proxy_retries(stack: Stack) -> int:
    assert stack.envoy is not None
    return stack.envoy.stat("cluster.map_service.upstream_rq_retry")


def check_each_frame_once(stack: Stack, robots: list[LightRobot]) -> None:
    operator = Operator(stack.address)
    for robot in robots:
        finished = robot.finish()
        assert finished.mapped == robot.sent == robot.answered
        assert [heard.answer.reply.T_map_lidar[0, 3] for heard in robot.heard] == list(range(1, robot.sent + 1))
        stored = operator.poses(robot.session_id)
        assert stored == [(seq, seq + FINAL_SHIFT_M) for seq in range(1, robot.sent + 1)]
    operator.close()


def go_on(robots: list[LightRobot], frames: int = 15) -> None:
    for robot in robots:
        robot.wait_answers(robot.answered + frames)


def test_after_sigkill_of_a_replica_others_go_on(whole: Stack, drive: Drive) -> None:
    robots = drive(3)
    wait_level(whole, [1, 1, 1])
    attempts, retries = [robot.attempt for robot in robots], proxy_retries(whole)
    since_s = time.monotonic()
    fullest(whole).kill()
    go_on(robots)
    check_gaps(robots, since_s, bars.KILLED_REPLICA_GAP_S)
    assert proxy_retries(whole) > retries, "the proxy itself goes past the dead one"
    # once at most on a busy machine, whose new owner is late to say Welcome
    assert all(robot.attempt <= before + 1 for robot, before in zip(robots, attempts, strict=True))
    assert sum(streams(replica) for replica in whole.replicas) == 3
    check_each_frame_once(whole, robots)


def test_a_replica_that_is_drained_says_where_there_is_room_and_leaves_nothing_to_repeat(
    whole: Stack, drive: Drive
) -> None:
    robots = drive(4)
    wait_level(whole, [1, 1, 2])
    leaving = fullest(whole)
    attempts = [robot.attempt + (owner(whole, robot) == leaving.name) for robot in robots]
    since_s = time.monotonic()
    assert leaving.drain() == 0
    assert time.monotonic() - since_s < 10
    go_on(robots)
    check_gaps(robots, since_s, bars.DRAINED_REPLICA_GAP_S)
    assert loads(whole) == [0, 2, 2]
    assert events(leaving, "not committed at drain") == events(leaving, "fenced") == []
    assert [robot.attempt for robot in robots] == attempts, "each found its place at the first try"
    check_each_frame_once(whole, robots)


def test_a_frozen_replica_is_left_and_cannot_write_when_it_wakes(whole: Stack, drive: Drive) -> None:
    """Front and workers stop until all robots go on elsewhere, with frames answered and not committed.

    Keyframes are seq 1, 6, 11, ...
    """
    robots = drive(3, UplinkConfig())
    wait_level(whole, [1, 1, 1])
    frozen = fullest(whole)
    before = fenced(frozen)
    theirs = next(robot for robot in robots if owner(whole, robot) == frozen.name)
    wait_until(lambda: theirs.answered % 5 == 3, 30.0, "a frame between two commits")
    workers = frozen.workers()
    since_s = time.monotonic()
    frozen.freeze()
    wait_until(lambda: frozen.address not in whole.envoy.healthy(), 60.0, "the proxy to take it out")
    go_on(robots)
    frozen.thaw()
    check_gaps(robots, since_s, bars.FROZEN_REPLICA_GAP_S)
    wait_until(lambda: fenced(frozen) > before, 60.0, "the zombie's commit refused")
    assert frozen.alive
    assert frozen.workers() == workers, "a worker was killed for the time in which its front was frozen"
    check_each_frame_once(whole, robots)


def test_a_new_replica_takes_its_share_and_sessions_then_stay_where_they_are(whole: Stack, drive: Drive) -> None:
    """Three replicas, two, three."""
    robots = drive(4)
    whole.remove_replica(whole.replicas[0])
    wait_until(lambda: loads(whole) == [2, 2], 60.0, "two and two robots")
    since_s = time.monotonic()
    new = whole.add_replica()
    wait_level(whole, [1, 1, 2])
    assert streams(new) >= 1
    moves = rebalanced(whole)
    time.sleep(2.5)  # twelve looks
    assert rebalanced(whole) == moves
    assert loads(whole) == [1, 1, 2]
    gaps_s = sorted(robot.gap_s(since_s) for robot in robots)
    stayed_s = gaps_s[1]  # two of four were moved: what the start of a program costs everybody is not the move's
    assert gaps_s[-1] <= bars.GAP_SLACK * bars.DRAINED_REPLICA_GAP_S * max(1.0, stayed_s / QUIET_GAP_S)
    check_each_frame_once(whole, robots)


def test_robots_find_their_replica_again_after_sigkill_of_the_proxy(whole: Stack, drive: Drive) -> None:
    """The sessions are still in the memory of their replicas: nothing is built again."""
    robots = drive(3)
    wait_level(whole, [1, 1, 1])
    before = [owner(whole, robot) for robot in robots]
    whole.envoy.kill()
    whole.envoy.start()
    go_on(robots)
    assert [owner(whole, robot) for robot in robots] == before
    check_each_frame_once(whole, robots)
