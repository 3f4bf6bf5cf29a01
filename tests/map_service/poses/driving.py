"""A robot that drives a session of the shared service."""

from __future__ import annotations

from collections.abc import Callable

from splitslam.wire import session_pb2 as session_pb
from tests.map_service.fakes import payload
from tests.map_service.harness import Robot7, frame

Connect = Callable[..., Robot7]
LATE_S = 3.0  # the store's way: a commit a second, a look each half second, and a busy machine


def drive(robot: Robot7, first: int, last: int, **content: object) -> None:
    for seq in range(first, last + 1):
        robot.ask(frame(seq, payload(**content) if content else None))  # type: ignore[arg-type]


def bye(robot: Robot7, last: int) -> None:
    robot.send(session_pb.Bye(last_seq=last))
    robot.next("finished")
