"""The chaos demo's own threads: none may die of what it does to others, and none may be waited for in vain."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import grpc
import pytest

from splitslam.chaos import show as showing
from splitslam.chaos.agent import Agent, Drive
from splitslam.chaos.script import Harm
from splitslam.chaos.show import Show
from splitslam.chaos.watch import AgentWatch, ReplicaStatus, read_metrics
from splitslam.wire import local_pb2, local_pb2_grpc

SOON_S = 20.0  # far more than any of it takes
SLEEPER = ("/bin/sh", "-c", "exec sleep 600")
NO_DRIVE = Drive(Path("none.bag"), Path("robot.yaml"), Path("none.tum"))


def ends_soon(work: threading.Thread) -> bool:
    work.join(SOON_S)
    return not work.is_alive()


def in_a_thread(work: Any) -> threading.Thread:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


@pytest.mark.parametrize(
    "answer",
    [
        b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\nsplitslam_edge_state 2\n",
        b"HTTP/1.0 200 OK\r\n\r\nsplitslam_edge_state 2\nsplitslam_edge_buf",
        b"HTTP/1.0 200 OK\r\n\r\nsplitslam_edge_state 2\nsplitslam_edge_buffer_frames 1e",
        b"HT",
        b"",
    ],
)
def test_a_process_that_is_killed_while_it_answers_counts_as_one_that_does_not(answer: bytes):
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer_in_part() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(answer)

        serving = in_a_thread(answer_in_part)
        assert read_metrics(listener.getsockname()[1]) == {}
        assert ends_soon(serving)


class SilentFeed(local_pb2_grpc.LocalPoseServiceServicer):
    """An agent that has no pose yet."""

    def __init__(self) -> None:
        self.asked, self.over = threading.Event(), threading.Event()

    def Watch(self, request: Any, context: Any) -> Iterator[local_pb2.WatchResponse]:
        self.asked.set()
        self.over.wait(2 * SOON_S)
        yield from ()


def test_nobody_waits_for_the_pose_of_an_agent_that_has_none(tmp_path: Path):
    feed, path = SilentFeed(), tmp_path / "a.sock"
    server = grpc.server(ThreadPoolExecutor(1))
    local_pb2_grpc.add_LocalPoseServiceServicer_to_server(feed, server)
    server.add_insecure_port(f"unix:{path}")
    server.start()
    watch = AgentWatch(Agent("robot-1", NO_DRIVE, "", tmp_path, socket=path))
    watch.start()
    try:
        assert feed.asked.wait(SOON_S)
        assert ends_soon(in_a_thread(watch.stop))
    finally:
        feed.over.set()
        server.stop(None).wait()


class AboutToBegin(Agent):
    """Lets the test act between a death and the next life."""

    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self.beginning, self.go_on = threading.Event(), threading.Event()

    def _begin(self) -> bool:
        if self.lives:
            self.beginning.set()
            self.go_on.wait(SOON_S)
        return super()._begin()


def test_an_agent_that_is_stopped_just_before_its_next_life_does_not_begin_it(tmp_path: Path):
    robot = tmp_path / "robot.yaml"
    robot.write_text("{}")
    agent = AboutToBegin("robot-1", Drive(Path(), robot, Path()), "", tmp_path / "agent", program=SLEEPER)
    agent.start()
    try:
        agent.process.kill()
        assert agent.beginning.wait(SOON_S)
        stopping = in_a_thread(agent.stop)
        assert agent._stopping.wait(SOON_S)
        agent.go_on.set()
        assert ends_soon(stopping)
        assert not agent.process.alive
        assert len(agent.lives) == 1
    finally:
        agent.process.kill()


class FakeReplica:
    name, metrics_port, ready = "replica-1", None, True

    def __init__(self) -> None:
        self.alive, self.starts = True, 0
        self.draining, self.drained = threading.Event(), threading.Event()

    def kill(self) -> None:
        self.alive = False

    def drain(self) -> None:
        self.draining.set()
        self.drained.wait(SOON_S)
        self.alive = False

    def start(self) -> None:
        if self.alive:
            raise showing.StackError("replica-1: runs already")
        self.alive, self.starts = True, self.starts + 1

    def last_line(self) -> str:
        return "ready"


@pytest.fixture
def one_replica(monkeypatch: pytest.MonkeyPatch) -> tuple[Show, FakeReplica]:
    monkeypatch.setattr(showing, "_RESTART_S", 0.01)
    replica: Any = FakeReplica()
    stack: Any = SimpleNamespace(replicas=[replica])
    show = Show(stack, [], [], 0.0, 40.0, [], ((0.0, 0.0), (1.0, 1.0)), keys=False)
    show._replicas[0].status = ReplicaStatus(word="up", streams=2)
    return show, replica


def test_a_harm_that_is_still_being_done_at_the_end_is_done_and_mended(one_replica: tuple[Show, FakeReplica]):
    show, replica = one_replica
    show.do(Harm(0.0, "drain replica", 0.0))
    assert replica.draining.wait(SOON_S)
    stopping = in_a_thread(show.stop)
    while not show._work._shutdown:
        stopping.join(0.01)
    replica.drained.set()
    assert ends_soon(stopping)
    assert [fault.what for fault in show.done] == ["replica-1 drained"]
    assert replica.starts == 1


def test_a_replica_that_two_keys_have_killed_is_started_once(one_replica: tuple[Show, FakeReplica]):
    show, replica = one_replica
    for _ in range(2):
        show.do(Harm(0.0, "kill replica", 0.0))
    show.stop()
    assert replica.starts == 1
    assert not [what for _, what in show._events if "does not start" in what]
