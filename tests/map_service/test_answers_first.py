"""Robots that all send in the same moment: each has its answer before anybody's frame is taken into a map."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from map_service.channel import HandOver, Open, Reply, Request
from map_service.config import ServiceConfig
from map_service.host import SessionHost
from map_service.settings import PipelineSettings
from map_service.store import Store
from splitslam.wire import session_pb2 as pb
from tests.logs.said import said
from tests.map_service.fakes import FakeEngine, FakePipeline, payload
from tests.map_service.harness import frame, hello, new_run


class Log(FakeEngine):
    """Says in which order things happen: ("answer" or "settle" or "commit", x of the frame, m)."""

    def __init__(self) -> None:
        super().__init__(PipelineSettings(), 1)
        self.steps: list[tuple[str, int]] = []
        self.robots = 0

    def create(self, request: Any, snapshot: Any) -> FakePipeline:
        self.robots += 1
        return Noting(self.steps, self.robots)


class Noting(FakePipeline):
    def __init__(self, steps: list[tuple[str, int]], robot: int) -> None:
        super().__init__(None)
        self._steps, self._robot = steps, robot

    def answer(self, frame: Any, fixes: Any) -> Any:
        self._steps.append(("answer", self._robot))
        return super().answer(frame, fixes)

    def settle(self) -> float | None:
        self._steps.append(("settle", self._robot))
        return super().settle()

    def take_commit(self) -> Any:
        self._steps.append(("commit", self._robot))
        return super().take_commit()


@pytest.fixture
def log() -> Log:
    return Log()


@pytest.fixture
def host(tmp_path: Path, log: Any) -> Iterator[SessionHost]:
    """Three robots, on streams 1 to 3."""
    url = f"sqlite:///{tmp_path / 'map.db'}"
    store = Store(url)
    host = SessionHost(ServiceConfig(store=url), log, store, lambda reply: None)
    for stream in (1, 2, 3):
        host.handle(Open(stream, f"rover-{stream}", hello(new_run(), robot_id=f"rover-{stream}").SerializeToString()))
    yield host
    host.drain()
    store.close()


def send(host: SessionHost, stream: int, seq: int, content: bytes | None = None) -> None:
    request = pb.StreamRequest(frame=frame(seq, content or payload()))
    host.handle(Request(stream, request.SerializeToString(), 0))


def test_every_robot_has_its_answer_before_a_map_or_the_store_takes_a_frame(host: SessionHost, log: Log) -> None:
    for stream in (1, 2, 3):
        send(host, stream, 1)
    while host.care():
        pass
    answers, settles, commits = (
        [robot for step, robot in log.steps if step == which] for which in ("answer", "settle", "commit")
    )
    assert answers == settles == commits == [1, 2, 3]
    assert [step for step, _ in log.steps] == ["answer"] * 3 + ["settle"] * 3 + ["commit"] * 3


def test_what_waits_is_done_before_the_robots_next_frame_at_the_latest(host: SessionHost, log: Log) -> None:
    send(host, 1, 1)
    send(host, 2, 1)
    send(host, 1, 2)
    of_first = [step for step, robot in log.steps if robot == 1]
    assert of_first == ["answer", "settle", "commit", "answer"]
    assert [step for step, robot in log.steps if robot == 2] == ["answer"]


def test_before_a_session_goes_to_another_replica_its_map_is_whole(host: SessionHost, log: Log) -> None:
    send(host, 1, 1)
    host.handle(HandOver(1))
    assert [step for step, robot in log.steps if robot == 1] == ["answer", "settle", "commit"]


def test_a_frame_that_fails_after_its_answer_ends_the_stream_before_the_next_one(host: SessionHost, log: Log) -> None:
    send(host, 1, 1, payload("unsettled"))
    send(host, 1, 2)
    assert host.sessions.on(1) is None
    assert log.steps.count(("answer", 1)) == 1
    send(host, 2, 1)
    assert log.steps.count(("answer", 2)) == 1


def test_the_answer_goes_out_whoever_waits_behind_it(tmp_path: Path) -> None:
    heard: list[Any] = []
    url = f"sqlite:///{tmp_path / 'map.db'}"
    store = Store(url)
    engine: Any = FakeEngine(PipelineSettings(), 1)
    host = SessionHost(ServiceConfig(store=url), engine, store, heard.append)
    host.handle(Open(1, "rover-7", hello(new_run()).SerializeToString()))
    heard.clear()
    send(host, 1, 1)
    assert [type(reply) for reply in heard] == [Reply]
    host.drain()
    store.close()


def test_what_is_logged_of_a_session_can_be_read_when_its_robot_hears_of_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    logged: dict[str, list[str]] = {}

    def hear(message: Any) -> None:
        if isinstance(message, Reply):
            kind = pb.StreamResponse.FromString(message.body).WhichOneof("message")
            logged[str(kind)] = [event for event, _ in said(caplog)]

    url = f"sqlite:///{tmp_path / 'map.db'}"
    store = Store(url)
    engine: Any = FakeEngine(PipelineSettings(), 1)
    host = SessionHost(ServiceConfig(store=url), engine, store, hear)
    with caplog.at_level(logging.INFO):
        host.handle(Open(1, "rover-7", hello(new_run()).SerializeToString()))
        send(host, 1, 1)
        host.handle(Request(1, pb.StreamRequest(bye=pb.Bye(last_seq=1)).SerializeToString(), 0))
        host.drain()
    store.close()
    assert "session open" in logged["welcome"]
    assert "session finished" in logged["finished"]
