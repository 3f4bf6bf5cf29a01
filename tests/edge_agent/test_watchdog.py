"""Signs of life stop when a thread is stuck, whichever it is, and only then."""

from __future__ import annotations

import logging
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from edge_agent.pulse import Pulse
from edge_agent.watchdog import Watchdog
from splitslam.notify import Notifier
from tests.logs.said import said

WATCHDOG_S = 0.4


class Listener:
    """The other end of sd_notify."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.setblocking(False)
        self.notifier = Notifier({"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6))})

    def heard(self) -> list[str]:
        """What has come since the last call."""
        found: list[str] = []
        while True:
            try:
                found.append(self._socket.recv(65536).decode())
            except BlockingIOError:
                return found

    def signs_of_life(self, within_s: float) -> int:
        """How many come in that time from now on."""
        self.heard()
        time.sleep(within_s)
        return self.heard().count("WATCHDOG=1")

    def until(self, beginning: str) -> None:
        """A message that begins so; on a busy machine it may take its time."""
        deadline_s = time.monotonic() + 30.0
        while not any(beginning in message for message in self.heard()):
            assert time.monotonic() < deadline_s, f"nothing with {beginning}"
            time.sleep(0.01)

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def listener(tmp_path: Path) -> Iterator[Listener]:
    listener = Listener(tmp_path / "notify")
    yield listener
    listener.close()


@pytest.mark.parametrize("which", [0, 1], ids=["source", "pipeline"])
def test_a_thread_that_is_stuck_stops_them_until_it_goes_on(
    which: int, listener: Listener, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    pulses = (Pulse("source"), Pulse("pipeline"))
    with (tmp_path / "stacks").open("w+") as stacks:
        watchdog = Watchdog(listener.notifier, pulses, lambda: 0, lambda: "tracking", stacks)
        watchdog.start()
        try:
            listener.until("WATCHDOG=1")
            with caplog.at_level(logging.WARNING), pulses[which].working():
                listener.until(f"STATUS=the {pulses[which].name} is stuck")
                assert listener.signs_of_life(2 * WATCHDOG_S) == 0
            listener.until("WATCHDOG=1")
        finally:
            watchdog.close()
        stacks.seek(0)
        assert stacks.read().count("Current thread") == 1  # once, though it was seen many times
    assert [(event, fields["thread"]) for event, fields in said(caplog)] == [
        ("thread stuck: no more signs of life", pulses[which].name),
        ("thread goes on", pulses[which].name),
    ]


def test_waiting_for_somebody_else_is_not_being_stuck(listener: Listener):
    pulse = Pulse("pipeline")
    watchdog = Watchdog(listener.notifier, (pulse,), lambda: 0, lambda: "")
    watchdog.start()
    try:
        with pulse.working():
            with pulse.waiting():
                time.sleep(WATCHDOG_S)
                assert pulse.busy_s == 0
                listener.heard()
                listener.until("WATCHDOG=1")
                until_s = time.monotonic()
            busy_s = pulse.busy_s
            assert busy_s <= time.monotonic() - until_s, "it begins anew"
    finally:
        watchdog.close()


def test_a_watchdog_that_is_meant_for_another_process_is_not_ours_and_nobody_to_tell_is_no_error(tmp_path: Path):
    address = {"NOTIFY_SOCKET": str(tmp_path / "gone")}
    assert Notifier({**address, "WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}).watchdog_s is None
    assert Notifier({**address, "WATCHDOG_USEC": "2000000"}).watchdog_s == 2.0
    assert Notifier({"WATCHDOG_USEC": "2000000"}).watchdog_s is None
    Notifier(address).ready("nobody listens")
    Notifier({}).alive()
    assert not Notifier({}).on


def test_an_abstract_socket_is_told_as_well():
    name = f"splitslam-test-{time.monotonic_ns()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(f"\0{name}")
        Notifier({"NOTIFY_SOCKET": f"@{name}"}).stopping("two\nlines")
        assert server.recv(4096) == b"STOPPING=1\nSTATUS=two lines"
