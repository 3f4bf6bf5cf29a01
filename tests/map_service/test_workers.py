"""Sessions and their workers: who has which, for how long, and when there is no room for more."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from splitslam.wire import session_pb2 as pb
from tests.map_service.harness import Held, Robot7, Service, frame, hello, new_run
from tests.map_service.test_survival import Connect


def test_a_session_stays_with_the_worker_that_holds_it(start_service: Callable[..., Service]) -> None:
    service = start_service(workers=2, commit={"every_s": 60.0, "every_frames": 1000})
    runs = [new_run() for _ in range(3)]
    robots = [Robot7(service.address, hello(run)) for run in runs]
    for seq in range(1, 5):
        robots[0].ask(frame(seq))
    robots[0].close()
    robots[1].close()  # its worker is the idle one now
    while service.metrics()["splitslam_map_streams"] > 1:
        time.sleep(0.02)
    back = Robot7(service.address, hello(runs[0]))
    welcome = back.next("welcome")
    assert (welcome.durable_seq, welcome.applied_seq) == (1, 4)
    for robot in (robots[2], back):
        robot.close()


def test_sessions_are_spread_over_the_workers(start_service: Callable[..., Service], tmp_path: Path) -> None:
    service = start_service(workers=2)
    robots = [Robot7(service.address, hello(new_run())) for _ in range(2)]
    for robot in robots:
        robot.ask(frame(1))
    held = Held(tmp_path)
    robots[0].send(frame(2, held.content))
    held.wait_begun()
    robots[1].ask(frame(2))  # or one waits for the other
    held.end()
    assert robots[0].next("odometry").seq == 2
    for robot in robots:
        robot.close()


def test_a_robot_over_the_limit_is_refused_with_a_time_to_come_back_but_never_one_that_is_served_already(
    start_service: Callable[..., Service], connect: Connect
) -> None:
    service = start_service(limits={"max_sessions": 1})
    connect(service).next("welcome")
    refused = connect(service, run_id=new_run()).next("refused")
    assert refused.reason == pb.REFUSED_REASON_OVERLOADED
    assert refused.retry_after_ms > 0
    assert connect(service).next("welcome").epoch == 2
    assert service.metrics()['splitslam_map_refused_total{reason="overloaded"}'] == 1


def test_no_new_robot_is_taken_while_a_frame_waits_too_long(
    start_service: Callable[..., Service], connect: Connect, tmp_path: Path
) -> None:
    service, held = start_service(limits={"max_delay_s": 0.3}), Held(tmp_path)
    first = connect(service)
    first.next("welcome")
    first.send(frame(1, held.content))
    held.wait_begun()
    time.sleep(0.4)
    assert "has waited" in connect(service, run_id=new_run()).next("refused").detail
    held.end()
    assert first.next("odometry").seq == 1
    connect(service, run_id=new_run()).next("welcome")


def test_a_detached_session_is_let_go_after_its_time_and_restored_when_the_robot_comes_back(
    start_service: Callable[..., Service], connect: Connect
) -> None:
    service = start_service(limits={"idle_s": 0.2})
    robot = connect(service)
    robot.ask(frame(1))
    robot.close()
    time.sleep(1.5)  # it is told of, and let go
    service.wait_metrics(lambda page: page['splitslam_map_sessions{state="detached"}'] == 0, "the session let go")
    back = connect(service)
    assert back.next("welcome").durable_seq == 1
    assert back.ask(frame(2)).pose_map_lidar.tx_m == 2.0
