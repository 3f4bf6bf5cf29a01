"""What passes between the front and a worker: whole messages, in order, whatever pieces the socket makes of them."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from map_service import channel
from map_service.channel import Close, DrainAll, Drained, Open, Ready, Request, WorkerEnd
from map_service.worker import Worker

Ends = tuple[socket.socket, WorkerEnd]


@pytest.fixture
def ends() -> Iterator[Ends]:
    """The front's socket, and the worker's end."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield ours, WorkerEnd(theirs)


def test_messages_come_whole_and_in_order_in_whatever_pieces_they_arrive(ends: Ends) -> None:
    ours, end = ends
    sent = [Open(1, "robot-7/run", b"hello"), Request(1, bytes(range(256)) * 40, 17), Close(1)]
    data, come = b"".join(map(channel.pack, sent)), []
    for begin in range(0, len(data), 1000):
        ours.sendall(data[begin : begin + 1000])
        come += end.receive(1.0) or []
        assert come == sent[: len(come)]
    assert come == sent


def test_all_that_has_come_is_taken_at_once(ends: Ends) -> None:
    ours, end = ends
    ours.sendall(b"".join(channel.pack(Close(n)) for n in range(50)))
    assert end.receive(1.0) == [Close(n) for n in range(50)]
    assert end.receive(0.0) == []


def test_the_worker_hears_that_its_front_is_gone(ends: Ends) -> None:
    ours, end = ends
    ours.close()
    assert end.receive(1.0) is None


class Host:
    """A SessionHost that notes what it is given, and which streams had ended by then."""

    config = SimpleNamespace(metrics=SimpleNamespace(per_robot=False))

    def __init__(self) -> None:
        self.closed: set[int] = set()
        self.handled: list[tuple[Any, set[int]]] = []
        self.sessions = SimpleNamespace(
            committing=False,
            durable=dict,
            states=dict,
            take_released=list,
            undurable_frames=0,
        )
        self.tally = SimpleNamespace(take=lambda: ({}, []))

    def handle(self, message: Any) -> None:
        self.handled.append((message, set(self.closed)))

    def care(self) -> bool:
        return False

    def look_after(self) -> None: ...

    def drain(self) -> None: ...

    def cpu_ns(self) -> int:
        return 0


class SilentWorker(Worker):
    """Gives no signs of life: the first after its front's end would end this process."""

    def _beat(self) -> None: ...


def test_a_stream_that_ended_while_its_open_waited_is_known_to_have_ended(ends: Ends) -> None:
    ours, end = ends
    waiting = [Open(1, "robot-7/run", b""), Open(2, "robot-8/run", b""), Close(1), DrainAll()]
    ours.sendall(b"".join(map(channel.pack, waiting)))
    host = Host()
    SilentWorker(host, end, queue_messages=4).run()  # pyright: ignore[reportArgumentType]
    assert [message for message, _ in host.handled] == waiting
    assert host.handled[0][1] == {1}


def test_a_worker_answers_a_message_as_soon_as_it_comes(ends: Ends) -> None:
    ours, end = ends
    host = Host()
    worker = threading.Thread(target=SilentWorker(host, end, queue_messages=4).run, daemon=True)  # pyright: ignore[reportArgumentType]
    worker.start()
    taken_s = []
    for n in range(20):
        time.sleep(0.01)
        before, start_s = len(host.handled), time.monotonic()
        ours.sendall(channel.pack(Close(n)))
        while len(host.handled) == before:
            time.sleep(0.0005)
        taken_s.append(time.monotonic() - start_s)
    ours.sendall(channel.pack(DrainAll()))
    worker.join(5.0)
    assert not worker.is_alive()
    assert sorted(taken_s)[10] < 0.1, "a worker with nothing to do looks each 0.25 s"
    told = bytearray(ours.recv(1 << 16))
    kinds = [type(message) for message in channel.take_whole(told)]
    assert kinds[0] is Ready
    assert kinds[-1] is Drained
