"""Ports that vanish are opened again, and what came while nobody looked keeps its time."""

from __future__ import annotations

import errno
import os
import pty
import select
import socket
import termios
import time
import tty
from collections.abc import Callable
from pathlib import Path

import pytest
import serial

from edge_agent.live_settings import Serial, Tcp
from edge_agent.sources.live.arrivals import ArrivalClock
from edge_agent.sources.live.ports import Port
from edge_agent.sources.live.stream_ports import SerialPort, TcpPort
from edge_agent.sources.live.udp_port import UdpPort
from splitslam.errors import InputError
from splitslam.stack.process import free_port, wait_until
from tests.live import wire


def udp_port(sender: str | None = None, receive_bytes: int = 2**20) -> UdpPort:
    return UdpPort("source.live.lidar.udp.port", ("127.0.0.1", 0), receive_bytes, sender, ArrivalClock())


def is_ready(port: Port) -> bool:
    """As the source asks."""
    assert port.fileno is not None
    poll = select.poll()
    poll.register(port.fileno, select.POLLOUT if port.writes else select.POLLIN)
    return bool(poll.poll(20))


def read_until(port: Port, done: Callable[[bytes], bool], timeout_s: float = 30.0) -> bytes:
    """What comes, tended as the source does."""
    got, deadline_s = b"", time.monotonic() + timeout_s
    while not done(got):
        assert time.monotonic() < deadline_s, got
        port.tend()
        if port.fileno is not None and is_ready(port):
            got += b"".join(data for data, _ in port.read())
    return got


def packets_of(port: Port, count: int) -> list[bytes]:
    """So many, and no more than have come by then: the system may deliver a moment later on a busy machine."""
    got: list[bytes] = []
    wait_until(lambda: bool(got.extend(data for data, _ in port.read()) or len(got) >= count), 30.0, f"{count} packets")
    return got


def test_a_packet_keeps_the_time_at_which_it_came_although_nobody_looked():
    port, clock = udp_port(), ArrivalClock()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for _ in range(20):  # the kernel begins to stamp some time after it was asked to
            before_ns = clock.now_ns()
            out.sendto(b"early", ("127.0.0.1", port.port))
            sent_ns = clock.now_ns()
            time.sleep(0.1)
            wait_until(lambda: is_ready(port), 30.0, "the packet")
            ((data, arrival_ns),) = port.read()
            if stamped := arrival_ns < sent_ns + 50_000_000:
                break
    port.close()
    assert data == b"early"
    assert stamped
    assert before_ns - 5_000_000 < arrival_ns < sent_ns + 5_000_000


def test_what_a_full_buffer_loses_is_counted():
    port = udp_port(receive_bytes=4096)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for _ in range(100):
            out.sendto(bytes(1206), ("127.0.0.1", port.port))
        got = len(list(port.read()))
        out.sendto(b"one more, that says so", ("127.0.0.1", port.port))
    got += len(packets_of(port, 1))
    assert 0 < got < 101
    assert got + port.counts["overflow"] == 101
    port.close()


def test_packets_of_another_sender_are_counted_and_left_out():
    port = udp_port(sender="127.0.0.9")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.sendto(b"foreign", ("127.0.0.1", port.port))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.bind(("127.0.0.9", 0))
        out.sendto(b"ours", ("127.0.0.1", port.port))
    assert packets_of(port, 1) == [b"ours"]
    assert port.counts == {"sender": 1}
    port.close()


def test_a_port_that_is_taken_is_one_clear_line():
    taken = udp_port()
    with pytest.raises(InputError, match=rf"source.live.lidar.udp.port: cannot listen on udp 127.0.0.1:{taken.port}"):
        UdpPort("source.live.lidar.udp.port", ("127.0.0.1", taken.port), 2**20, None, ArrivalClock())
    taken.close()


def test_a_serial_device_that_is_not_there_yet_is_waited_for_and_opened_again_when_it_was_unplugged(tmp_path: Path):
    device = tmp_path / "ttyIMU"
    port = SerialPort("imu", Serial(device=device), ArrivalClock())
    assert port.fileno is None
    for text in (b"first", b"second"):
        controller, terminal = pty.openpty()
        tty.setraw(terminal)
        device.unlink(missing_ok=True)
        device.symlink_to(os.ttyname(terminal))
        deadline_s = time.monotonic() + 30.0
        while port.fileno is None:
            assert time.monotonic() < deadline_s
            port.tend()
        os.write(controller, text)
        assert read_until(port, lambda got, text=text: got.endswith(text)) == text
        os.close(terminal)
        os.close(controller)
        deadline_s = time.monotonic() + 30.0
        while port.fileno is not None and time.monotonic() < deadline_s:
            list(port.read())
        assert port.fileno is None
    assert port.counts["disconnects"] == 3
    port.close()


def test_a_serial_device_that_vanishes_while_it_is_opened_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def unplugged(*_: object) -> None:
        raise termios.error(errno.EIO, "Input/output error")

    with wire.terminal(tmp_path) as (device, _), monkeypatch.context() as patched:
        patched.setattr(termios, "tcflush", unplugged)
        port = SerialPort("imu", Serial(device=device), ArrivalClock())
        assert port.fileno is None
        patched.undo()
        deadline_s = time.monotonic() + 30.0
        while port.fileno is None and time.monotonic() < deadline_s:
            port.tend()
        assert port.fileno is not None
        port.close()


def test_a_rate_that_the_device_cannot_do_is_one_clear_line_at_the_start_and_waited_for_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def refused(*_: object) -> None:
        raise ValueError("Failed to set custom baud rate (31337): refused")

    monkeypatch.setattr(serial.Serial, "_set_special_baudrate", refused)
    with (
        wire.terminal(tmp_path) as (device, _),
        pytest.raises(InputError, match=r"source.live.imu.serial.baud: 31337: .* a rate that the device can do"),
    ):
        SerialPort("imu", Serial(device=device, baud=31337), ArrivalClock())
    device.unlink()
    port = SerialPort("imu", Serial(device=device, baud=31337), ArrivalClock())
    with wire.terminal(tmp_path):  # now it is plugged in
        time.sleep(1.1)
        port.tend()
        assert port.fileno is None


def test_a_server_that_goes_away_is_connected_to_again():
    server = socket.create_server(("127.0.0.1", 0))
    port = TcpPort("gnss", Tcp(host="127.0.0.1", port=server.getsockname()[1]), ArrivalClock())
    for text in (b"first", b"second"):
        port.tend()
        time.sleep(0.01)
        deadline_s = time.monotonic() + 30.0
        server.settimeout(0.05)
        while True:
            assert time.monotonic() < deadline_s
            port.tend()
            try:
                connection, _ = server.accept()
                break
            except TimeoutError:
                continue
        connection.sendall(text)
        assert read_until(port, lambda got, text=text: got.endswith(text)) == text
        connection.close()
        while port.fileno is not None:
            list(port.read())
    assert port.counts["disconnects"] == 2
    port.close()
    server.close()


def test_nobody_listening_is_tried_again_without_an_end():
    number = free_port()
    port = TcpPort("gnss", Tcp(host="127.0.0.1", port=number), ArrivalClock())
    for _ in range(3):
        port.tend()
        list(port.read())
        port._again_s = 0.0
    assert port.counts["disconnects"] == 1  # said once
    port.close()


def test_arrivals_do_not_follow_the_wall_clock(monkeypatch: pytest.MonkeyPatch):
    clock, step_ns, soon_ns = ArrivalClock(), 3_600_000_000_000, 60_000_000_000  # on a busy machine
    before_ns, real_ns = clock.now_ns(), time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real_ns() - step_ns)
    assert 0 <= clock.now_ns() - before_ns < soon_ns
    assert 0 <= clock.of_wall_ns(real_ns()) - before_ns < soon_ns  # a stamp of before the step
    assert 0 <= clock.of_wall_ns(real_ns() - step_ns) - before_ns < soon_ns
