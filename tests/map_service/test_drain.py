"""A service that is told to end says so, commits what it has, and ends in time."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from splitslam.stack.process import wait_until
from splitslam.wire import session_pb2 as pb
from tests.map_service.fakes import payload
from tests.map_service.harness import WAIT_S, Held, Service, descendants, frame
from tests.map_service.test_survival import Connect, wait_until_gone


def test_sigterm_drains_tells_robots_commits_and_exits_with_zero(
    service: Service, connect: Connect, session_id: str
) -> None:
    channel = grpc.insecure_channel(service.address)
    watch = health_pb2_grpc.HealthStub(channel).Watch(  # pyright: ignore[reportAttributeAccessIssue]
        health_pb2.HealthCheckRequest()
    )
    assert next(watch).status == health_pb2.HealthCheckResponse.SERVING
    robot = connect(service)
    for seq in range(1, 9):
        robot.ask(frame(seq))
    processes = descendants(service.pid)
    assert service.workers()[0] in processes
    start_s = time.monotonic()
    assert service.terminate() == 0
    assert time.monotonic() - start_s < 20
    assert next(watch).status == health_pb2.HealthCheckResponse.NOT_SERVING
    drain = robot.next("drain")
    assert drain.reason == pb.DRAIN_REASON_SHUTDOWN
    assert robot.next("credit").durable_seq == 8, "the last credit says what the final commit has saved"
    assert robot.end() == grpc.StatusCode.UNAVAILABLE
    channel.close()
    assert wait_until_gone(processes) == []
    service.start()
    assert connect(service).next("welcome").durable_seq == 8


def test_a_service_that_drains_answers_what_it_has_and_takes_no_new_stream(
    service: Service, connect: Connect, tmp_path: Path
) -> None:
    robot, held = connect(service), Held(tmp_path)
    robot.next("welcome")
    robot.send(frame(1, held.content))
    held.wait_begun()
    assert service.process is not None
    service.process.terminate()
    robot.next("drain")
    late = connect(service)
    assert late.end() == grpc.StatusCode.UNAVAILABLE
    assert late.inbox.get() is None, "without a message, so that a proxy may try elsewhere"
    held.end()
    assert robot.next("odometry").seq == 1
    assert service.process.wait(WAIT_S) == 0


def test_a_drain_that_takes_too_long_is_cut_short(
    start_service: Callable[..., Service], connect: Connect, tmp_path: Path
) -> None:
    service, begun = start_service(drain_s=1.0), tmp_path / "begun"
    robot = connect(service)
    robot.next("welcome")
    robot.send(frame(1, payload("sleep", seconds=60, begun=str(begun))))
    wait_until(begun.exists, 20.0, "the frame at work")
    processes = descendants(service.pid)
    start_s = time.monotonic()
    assert service.terminate() == 0
    assert time.monotonic() - start_s < 15  # of the minute that the frame takes
    assert wait_until_gone(processes) == []
