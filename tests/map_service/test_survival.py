"""Whatever dies, every frame is mapped exactly once and nothing is left behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import grpc
import numpy as np
import pytest

from edge_agent.wire import answer
from splitslam.stack.process import wait_until
from splitslam.wire import session_pb2 as pb
from tests.conftest import ROOT
from tests.map_service.fakes import FINAL_SHIFT_M, payload
from tests.map_service.harness import WAIT_S, Held, Operator, Robot7, Service, descendants, frame, running

Connect = Callable[..., Robot7]
GONE_S = 30.0


def wait_until_gone(pids: list[int]) -> list[int]:
    """Those that are still there after a while."""
    until_s = time.monotonic() + GONE_S
    while (left := [pid for pid in pids if running(pid)]) and time.monotonic() < until_s:
        time.sleep(0.02)
    return left


def finish(robot: Robot7, last_seq: int) -> None:
    robot.send(pb.Bye(last_seq=last_seq))
    assert robot.next("finished").mapped == last_seq


def ask_all(robot: Robot7, first: int, last: int) -> None:
    """As many at a time as a robot may have unanswered."""
    for begin in range(first, last + 1, 10):
        some = range(begin, min(begin + 10, last + 1))
        for seq in some:
            robot.send(frame(seq))
        assert [robot.next("odometry").pose_map_lidar.tx_m for _ in some] == list(some)


def final(last_seq: int) -> list[tuple[int, float]]:
    """The trajectory when each frame was mapped exactly once."""
    return [(seq, seq + FINAL_SHIFT_M) for seq in range(1, last_seq + 1)]


def test_after_sigkill_of_the_service_a_restart_on_store_and_port_goes_on_and_maps_every_frame_once(
    service: Service, connect: Connect, operator: Operator, session_id: str
) -> None:
    robot = connect(service)
    for seq in range(1, 42):
        robot.ask(frame(seq))
    robot.wait_durable(41)
    for seq in range(42, 48):
        robot.ask(frame(seq))
    service.kill()
    assert robot.end() == grpc.StatusCode.UNAVAILABLE
    service.start()
    resumed = connect(service)
    welcome = resumed.next("welcome")
    assert welcome.epoch == 2
    assert 41 <= welcome.durable_seq <= 47
    assert welcome.applied_seq == welcome.durable_seq
    assert welcome.last_poses[-1].seq == welcome.durable_seq
    assert welcome.last_poses[-1].pose.tx_m == welcome.durable_seq
    assert welcome.pose_map_odom.tx_m == 0.5
    stored = resumed.ask(frame(30))
    assert (stored.duplicate, stored.pose_map_lidar.tx_m, stored.pose_map_odom.tx_m) == (True, 30.0, 0.5)
    assert not answer(stored, round_trip_s=0.0).reply.rejected, "the agent takes it"
    for seq in range(welcome.durable_seq + 1, 61):
        assert resumed.ask(frame(seq)).pose_map_lidar.tx_m == seq
    finish(resumed, 60)
    assert operator.poses(session_id) == final(60)


def test_after_sigkill_scans_that_had_moved_into_blocks_are_there_once(
    start_service: Callable[..., Service], connect: Connect, session_id: str
) -> None:
    service = start_service(housekeeping_s=0.05)
    robot = connect(service)
    moved = "splitslam_map_scans_in_blocks_total"
    seq = 0
    while not service.metrics().get(moved):
        ask_all(robot, seq + 1, seq + 100)
        seq += 100
        assert seq < 3000
    service.kill()
    assert robot.end() == grpc.StatusCode.UNAVAILABLE
    service.start()
    resumed = connect(service)
    durable = resumed.next("welcome").durable_seq
    ask_all(resumed, durable + 1, seq)
    old = resumed.ask(frame(3))
    assert old.duplicate
    assert (old.pose_map_lidar.tx_m, old.pose_map_odom.tx_m) == pytest.approx((3.0, 0.5))
    finish(resumed, seq)
    operator = Operator(service.address)
    poses = operator.poses(session_id)
    operator.close()
    assert np.array(poses) == pytest.approx(np.array(final(seq)))


def test_a_new_stream_goes_on_without_a_rebuild_and_ends_the_old_one(service: Service, connect: Connect) -> None:
    first = connect(service)
    for seq in range(1, 4):
        first.ask(frame(seq))
    second = connect(service)
    welcome = second.next("welcome")
    assert (welcome.epoch, welcome.applied_seq) == (2, 3)
    assert first.end() == grpc.StatusCode.ABORTED
    assert second.ask(frame(4)).pose_map_lidar.tx_m == 4.0


def test_an_owner_that_was_overtaken_is_fenced_and_cannot_harm_the_session(
    start_service: Callable[..., Service], connect: Connect, session_id: str
) -> None:
    """Two replicas on one store: the robot moves from one to the other while the first still thinks it owns it."""
    old = start_service()
    new = start_service()
    zombie = connect(old)
    for seq in range(1, 8):
        zombie.ask(frame(seq))
    zombie.wait_durable(6)
    robot = connect(new)
    durable = robot.next("welcome").durable_seq
    assert durable >= 6
    for seq in range(durable + 1, 21):
        robot.ask(frame(seq))
    zombie.send(frame(8))
    assert zombie.end() == grpc.StatusCode.ABORTED
    assert zombie.detail.startswith("fenced")
    finish(robot, 20)
    operator = Operator(new.address)
    assert operator.poses(session_id) == final(20)
    operator.close()
    fenced = "splitslam_map_fenced_total"
    assert old.wait_metrics(lambda page: page[fenced] > 0, "the refusal counted")[fenced] == 1


def test_a_replica_gets_a_session_back_that_another_owned_in_between(
    start_service: Callable[..., Service], connect: Connect, session_id: str
) -> None:
    one, two = start_service(), start_service()
    for service, frames in ((one, range(1, 6)), (two, range(6, 11)), (one, range(11, 16))):
        robot = connect(service)
        durable = robot.next("welcome").durable_seq
        for seq in range(durable + 1, frames.stop):
            assert robot.ask(frame(seq)).pose_map_lidar.tx_m == seq
        robot.close()
        operator = Operator(service.address)
        last = frames.stop - 1
        wait_until(lambda o=operator, n=last: o.get(session_id).durable_seq >= n, WAIT_S, "the commit of what is left")
        operator.close()


def test_a_worker_that_dies_is_restarted_and_its_sessions_resume(
    service: Service, connect: Connect, operator: Operator, session_id: str, tmp_path: Path
) -> None:
    robot = connect(service)
    for seq in range(1, 8):
        robot.ask(frame(seq))
    robot.wait_durable(6)
    poison = frame(8, payload("crash", once=str(tmp_path / "crashed")))
    robot.send(poison)
    assert robot.end() == grpc.StatusCode.UNAVAILABLE
    assert "worker of this session has died" in robot.detail
    resumed = connect(service)
    start = resumed.next("welcome").durable_seq + 1
    assert start >= 6
    for seq in range(start, 8):
        resumed.ask(frame(seq))
    assert resumed.ask(poison).pose_map_lidar.tx_m == 8.0
    finish(resumed, 8)
    assert operator.poses(session_id) == final(8)
    assert service.metrics()["splitslam_map_worker_restarts_total"] == 1


def test_a_frozen_worker_is_killed_and_its_streams_end(start_service: Callable[..., Service], connect: Connect) -> None:
    service = start_service(limits={"silent_s": 3.0})
    robot = connect(service)
    robot.ask(frame(1))
    os.kill(service.workers()[0], signal.SIGSTOP)
    assert robot.end() == grpc.StatusCode.UNAVAILABLE
    assert connect(service).next("welcome").epoch == 2


def test_a_worker_stuck_in_one_job_is_killed(start_service: Callable[..., Service], connect: Connect) -> None:
    service = start_service(limits={"stall_s": 1.0})
    robot = connect(service)
    robot.send(frame(1, payload("sleep", seconds=60)))
    assert robot.end() == grpc.StatusCode.UNAVAILABLE


def test_a_slow_frame_does_not_silence_the_service(service: Service, connect: Connect, tmp_path: Path) -> None:
    robot, held = connect(service), Held(tmp_path)
    robot.next("welcome")
    robot.send(frame(1, held.content))
    held.wait_begun()
    for _ in range(4):  # one may have been on its way
        robot.next("credit")
    held.end()
    assert robot.next("odometry").seq == 1


@pytest.mark.parametrize("workers", [1, 3])
def test_no_process_outlives_a_front_that_was_killed(
    start_service: Callable[..., Service], connect: Connect, workers: int
) -> None:
    service = start_service(workers=workers)
    connect(service).ask(frame(1))
    processes = descendants(service.pid)
    assert set(service.workers()) <= set(processes)
    assert len(service.workers()) == workers
    service.kill()
    assert wait_until_gone(processes) == []


def test_a_frozen_worker_does_not_outlive_the_front(service: Service, connect: Connect) -> None:
    """It cannot notice the end of its socket: the kernel must do it."""
    connect(service).ask(frame(1))
    (worker,) = service.workers()
    os.kill(worker, signal.SIGSTOP)
    service.kill()
    assert wait_until_gone([worker]) == []


def test_no_process_of_the_loop_pool_outlives_its_worker() -> None:
    command = [sys.executable, "-m", "tests.map_service.loop_pool_owner"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout is not None
        said = json.loads(owner.stdout.readline())
        pool = descendants(owner.pid)
        owner.kill()
    assert said["accepted"] is False
    assert said["cpu_ns"] > 0
    assert len(pool) >= 2
    assert wait_until_gone(pool) == []
