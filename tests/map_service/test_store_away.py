"""The service while its PostgreSQL is dead: answers go on, nothing is called durable that is not, nothing is lost."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from itertools import count, pairwise
from pathlib import Path

import grpc

from map_service.catalog import Catalog
from map_service.store import Store
from splitslam.wire import session_pb2 as pb
from tests.map_service.fakes import FINAL_SHIFT_M, payload
from tests.map_service.harness import WAIT_S, Operator, Robot7, Service, frame, hello, new_run
from tests.postgres import DatabaseServer

AWAY_S = 3.0
PERIOD_S = 0.05
LONGEST_GAP_S = 4.0
BACKLOG = 100
WINDOW = 16
BEFORE = 20


class Listener:
    """What a robot hears, in order, with the time."""

    def __init__(self, robot: Robot7) -> None:
        self.robot = robot
        self.answered: list[tuple[int, float]] = []
        self.durable_seq = 0

    def listen(self, seconds: float, until_seq: int = 0) -> None:
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0 and not (until_seq and self.seq >= until_seq):
            try:
                response = self.robot.inbox.get(timeout=left_s)
            except queue.Empty:
                return
            assert response is not None, f"the stream ended with {self.robot.status}: {self.robot.detail}"
            match response.WhichOneof("message"):
                case "odometry":
                    self.answered.append((response.odometry.seq, time.monotonic()))
                    self.durable_seq = max(self.durable_seq, response.odometry.durable_seq)
                case "credit":
                    self.durable_seq = max(self.durable_seq, response.credit.durable_seq)

    @property
    def seq(self) -> int:
        return self.answered[-1][0] if self.answered else 0


def test_a_store_that_dies_for_three_seconds_costs_no_frame_and_no_answer(
    postgres: DatabaseServer, start_service: Callable[..., Service], connect: Callable[..., Robot7], session_id: str
) -> None:
    url = postgres.empty_database()
    limits = {"window_frames": WINDOW, "max_delay_s": 60.0}  # frames that are held long here are no overload
    service = start_service(store=url, commit={"backlog_frames": BACKLOG}, limits=limits)
    robot = Listener(connect(service))
    for seq in range(1, BEFORE + 1):
        robot.robot.send(frame(seq))
        robot.listen(PERIOD_S)
    while robot.durable_seq < BEFORE:
        robot.listen(PERIOD_S)
    killed_s = time.monotonic()
    postgres.kill()
    try:
        seq = BEFORE
        while time.monotonic() < killed_s + AWAY_S:
            seq += 1
            robot.robot.send(frame(seq))
            robot.listen(PERIOD_S)
        robot.listen(WAIT_S, until_seq=seq)
        assert robot.seq == seq, "answers go on"
        times = [killed_s, *(at_s for seq, at_s in robot.answered if seq > BEFORE)]
        assert max(b - a for a, b in pairwise(times)) < LONGEST_GAP_S
        assert robot.durable_seq == BEFORE, "nothing new is durable"
        last = BEFORE + BACKLOG + WINDOW
        for late in range(seq + 1, last + 1):
            robot.robot.send(frame(late))
        robot.listen(WAIT_S, until_seq=BEFORE + BACKLOG)
        robot.listen(1.0)
        assert robot.seq == BEFORE + BACKLOG, "what is not durable is bounded: the rest waits in the window"
        other = Robot7(service.address, hello(new_run()))
        refused = other.next("refused")
        assert refused.reason == pb.REFUSED_REASON_STORE
        assert refused.retry_after_ms > 0
        other.close()
    finally:
        postgres.start()
    robot.listen(WAIT_S, until_seq=last)
    assert [seq for seq, _ in robot.answered] == list(range(1, last + 1))
    robot.robot.send(pb.Bye(last_seq=last))
    assert robot.robot.next("finished").mapped == last
    operator = Operator(service.address)
    assert operator.poses(session_id) == [(seq, seq + FINAL_SHIFT_M) for seq in range(1, last + 1)]
    operator.close()
    assert service.metrics()['splitslam_map_commits_total{result="retried"}'] > 1


def test_what_was_called_durable_is_in_the_store_after_it_was_killed_under_load(
    postgres: DatabaseServer, start_service: Callable[..., Service], connect: Callable[..., Robot7], session_id: str
) -> None:
    url = postgres.empty_database()
    service = start_service(store=url, commit={"every_frames": 1})
    robot = Listener(connect(service))
    for seq in count(1):
        robot.robot.send(frame(seq))
        robot.listen(0.002)
        if seq >= 200 and robot.durable_seq:
            break
    postgres.kill()
    robot.listen(1.0)
    service.kill()
    postgres.start()
    store = Store(url)
    row = Catalog(store).session(session_id)
    store.close()
    assert row is not None
    assert 0 < robot.durable_seq <= row.last_seq


def test_a_store_that_fails_in_the_middle_of_a_frame_has_it_mapped_once_all_the_same(
    service: Service, connect: Callable[..., Robot7], operator: Operator, session_id: str, tmp_path: Path
) -> None:
    robot = connect(service)
    for seq in range(1, 8):
        robot.ask(frame(seq))
    robot.wait_durable(6)
    harmed = frame(8, payload("away", once=str(tmp_path / "was away")))
    robot.send(harmed)
    assert robot.end() == grpc.StatusCode.UNAVAILABLE
    resumed = connect(service)
    for seq in range(resumed.next("welcome").durable_seq + 1, 8):
        resumed.ask(frame(seq))
    assert resumed.ask(harmed).pose_map_lidar.tx_m == 8.0
    resumed.send(pb.Bye(last_seq=8))
    assert resumed.next("finished").mapped == 8
    assert operator.poses(session_id) == [(seq, seq + FINAL_SHIFT_M) for seq in range(1, 9)]
