"""What a daemon tells systemd: sd_notify(3), one datagram a message, and nothing at all where systemd does not ask."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Mapping

_SEND_S = 1.0  # systemd reads at once; one that does not must not hold up the daemon


class Notifier:
    """Speaks to $NOTIFY_SOCKET. watchdog_s: how long systemd waits for a sign of life, None: it does not.

    Every method may be called from any thread.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        if self._address.startswith("@"):  # Linux' abstract namespace
            self._address = "\0" + self._address[1:]
        self.watchdog_s = _watchdog_s(environment) if self._address else None

    @property
    def on(self) -> bool:
        """Whether anybody listens."""
        return bool(self._address)

    def ready(self, status: str) -> None:
        """The start (or a reload) is complete."""
        self._send("READY=1", f"STATUS={_line(status)}")

    def status(self, text: str) -> None:
        """What `systemctl status` shows."""
        self._send(f"STATUS={_line(text)}")

    def alive(self) -> None:
        """A sign of life."""
        self._send("WATCHDOG=1")

    def reloading(self) -> None:
        """The configuration is being read again; `ready` ends it."""
        self._send("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self, status: str) -> None:
        """The end has begun."""
        self._send("STOPPING=1", f"STATUS={_line(status)}")

    def _send(self, *fields: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
            sender.settimeout(_SEND_S)
            with contextlib.suppress(OSError):  # a listener that is gone: there is nobody to tell
                sender.sendto("\n".join(fields).encode(), self._address)


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    """$WATCHDOG_USEC, unless it is meant for another process ($WATCHDOG_PID)."""
    with contextlib.suppress(ValueError):
        if int(environment.get("WATCHDOG_PID") or os.getpid()) == os.getpid():
            return int(environment.get("WATCHDOG_USEC", "0")) * 1e-6 or None
    return None


def _line(text: str) -> str:
    return " ".join(text.split())
