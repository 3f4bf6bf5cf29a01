"""The links that the chaos suite breaks do what they are told: otherwise it would prove nothing."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator

import pytest

from splitslam.chaos.link import Link, Quality
from splitslam.stack.process import free_port


@pytest.fixture
def echo() -> Iterator[str]:
    """A server that sends back what it gets."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve(end: socket.socket) -> None:
        with end:
            try:
                while data := end.recv(65536):
                    end.sendall(data)
            except OSError:
                pass

    def accept() -> None:
        while True:
            try:
                end, _ = listener.accept()
            except OSError:
                return
            threading.Thread(target=serve, args=(end,), daemon=True).start()

    thread = threading.Thread(target=accept, daemon=True)
    thread.start()
    yield f"127.0.0.1:{listener.getsockname()[1]}"
    listener.shutdown(socket.SHUT_RDWR)
    listener.close()
    thread.join()


@pytest.fixture
def link(echo: str) -> Iterator[Link]:
    with Link(echo) as link:
        yield link


def connect(link: Link, timeout_s: float = 30.0) -> socket.socket:
    host, _, port = link.address.rpartition(":")
    return socket.create_connection((host, int(port)), timeout_s)


def ask(end: socket.socket, data: bytes = b"hello") -> bytes:
    end.sendall(data)
    back = b""
    while len(back) < len(data) and (more := end.recv(65536)):
        back += more
    return back


def test_a_healthy_link_carries_every_byte_in_order(link: Link):
    data = bytes(range(256)) * 4000
    with connect(link) as end:
        threading.Thread(target=end.sendall, args=(data,), daemon=True).start()
        back = b""
        while len(back) < len(data):
            back += end.recv(65536)
    assert back == data
    assert (link.bytes_up, link.bytes_down) == (len(data), len(data))


def test_a_slow_link_carries_what_it_is_rated_for(link: Link):
    link.quality = Quality(kbps=1600)  # 200 kB/s
    with connect(link) as end:
        start_s = time.monotonic()
        assert len(ask(end, bytes(116_000))) == 116_000
    took_s = time.monotonic() - start_s
    assert 0.5 <= took_s < 10.0, "116 kB less a burst of 16 kB at 200 kB/s"


def test_delay_is_one_way_and_costs_no_throughput(link: Link):
    link.quality = Quality(delay_s=0.5)
    with connect(link) as end:
        start_s = time.monotonic()
        ask(end)
        assert 1.0 <= time.monotonic() - start_s < 15.0
        start_s = time.monotonic()
        for number in range(20):
            end.sendall(bytes([number]))
            time.sleep(0.01)
        back = b""
        while len(back) < 20:
            back += end.recv(100)
        assert back == bytes(range(20))
        assert time.monotonic() - start_s < 15.0, "one after the other they would take 20 s"


def test_a_lost_packet_is_a_stall_and_not_a_hole(link: Link):
    link.quality = Quality(loss=1.0)
    with connect(link) as end:
        start_s = time.monotonic()
        assert ask(end) == b"hello"
    assert time.monotonic() - start_s >= 0.4


def test_a_partition_is_silent_and_what_was_under_way_arrives_when_it_heals(link: Link):
    with connect(link) as end:
        ask(end)
        link.partition()
        end.settimeout(0.5)
        end.sendall(b"later")
        with pytest.raises(TimeoutError):
            end.recv(10)
        link.heal()
        end.settimeout(30.0)
        assert end.recv(10) == b"later"


def test_a_partition_swallows_new_connections_without_a_refusal(link: Link):
    link.partition()
    with pytest.raises(TimeoutError):
        connect(link, timeout_s=0.5)
    link.heal()
    with connect(link) as end:
        assert ask(end) == b"hello"


def test_a_cut_resets_connections_and_takes_new_ones(link: Link):
    with connect(link) as end:
        ask(end)
        link.cut()
        with pytest.raises(ConnectionResetError):
            ask(end)
    with connect(link) as end:
        assert ask(end) == b"hello"


def test_a_server_that_is_not_there_is_not_there_behind_the_link_either():
    port = free_port()
    # the reset comes with the first byte or already with the connection, as the threads run
    with Link(f"127.0.0.1:{port}") as link, pytest.raises(ConnectionResetError), connect(link) as end:
        ask(end)
