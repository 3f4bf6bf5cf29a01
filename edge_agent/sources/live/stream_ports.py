"""Streams of bytes, from serial devices and TCP servers, that are opened again when they vanish."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import socket
import termios
import time
from collections import Counter
from collections.abc import Iterator

from edge_agent.live_settings import Serial, Tcp
from edge_agent.sources.live.arrivals import ArrivalClock
from splitslam.errors import InputError
from splitslam.logs import fields

_log = logging.getLogger(__name__)

_LARGEST = 65535
_AGAIN_S = 1.0
_SILENT_S = 10.0  # a server whose machine is gone says nothing of it


class Reopened:
    """A port that may vanish, and is opened again a second later, for as long as it takes; said once each time."""

    def __init__(self, sensor: str, name: str, clock: ArrivalClock) -> None:
        self.counts: Counter[str] = Counter()
        self._sensor, self._name, self._clock = sensor, name, clock
        self._again_s = 0.0
        self._told = False

    def lost(self, detail: str) -> None:
        """Says it, once until it is back."""
        self._again_s = time.monotonic() + _AGAIN_S
        if not self._told:
            said = fields(sensor=self._sensor, where=self._name, detail=detail)
            _log.warning("sensor not connected", extra=said)
            self.counts["disconnects"] += 1
        self._told = True

    def back(self) -> None:
        """It is open."""
        if self._told:
            _log.warning("sensor connected", extra=fields(sensor=self._sensor, where=self._name))
        self._told = False

    @property
    def due(self) -> bool:
        """Time to try again."""
        return time.monotonic() >= self._again_s


class SerialPort(Reopened):
    """A serial device. One that is not there yet is waited for; one that we may not open is an error at the start."""

    writes = False

    def __init__(self, sensor: str, settings: Serial, clock: ArrivalClock) -> None:
        super().__init__(sensor, str(settings.device), clock)
        self._settings = settings
        self._serial = None
        try:
            self._open()
        except PermissionError as error:
            raise InputError(
                f"source.live.{sensor}.serial.device: {settings.device}: {error.strerror}; expected a device that the"
                " agent's user may read (group dialout)"
            ) from None
        except ValueError as error:
            raise InputError(
                f"source.live.{sensor}.serial.baud: {settings.baud}: {error}; expected a rate that the device can do"
            ) from None
        except OSError as error:
            self.lost(str(error))

    @property
    def fileno(self) -> int | None:
        return None if self._serial is None else self._serial.fileno()

    def read(self) -> Iterator[tuple[bytes, int]]:
        if self._serial is None:
            return
        try:
            data = os.read(self._serial.fileno(), _LARGEST)
        except BlockingIOError:
            return
        except OSError as error:
            self._vanished(str(error))
            return
        if not data:
            self._vanished("end of file")
            return
        yield data, self._clock.now_ns()

    def tend(self) -> None:
        if self._serial is None and self.due:
            try:
                self._open()
            except (OSError, ValueError) as error:
                self.lost(str(error))

    def close(self) -> None:
        if self._serial is not None:
            self._serial.close()
            self._serial = None

    def _open(self) -> None:
        """Raises OSError, ValueError for a rate that the device cannot do; pyserial's own error is an OSError."""
        import serial

        device, baud = str(self._settings.device), self._settings.baud
        try:
            opened = serial.Serial(device, baud, timeout=0, exclusive=True)
        except serial.SerialException as error:
            if error.errno == errno.EACCES:
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES)) from None
            raise
        except termios.error as error:  # unplugged while it was set up; to Python that is no OSError
            raise OSError(*error.args) from None
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            opened.set_low_latency_mode(True)  # USB adapters otherwise keep bytes for 16 ms
        self._serial = opened
        self.back()

    def _vanished(self, detail: str) -> None:
        self.close()
        self.lost(detail)


class TcpPort(Reopened):
    """A connection to a server, made again whenever it breaks."""

    def __init__(self, sensor: str, settings: Tcp, clock: ArrivalClock) -> None:
        super().__init__(sensor, f"{settings.host}:{settings.port}", clock)
        self._settings = settings
        self._socket: socket.socket | None = None
        self._connecting = False
        self._heard_s = 0.0

    @property
    def fileno(self) -> int | None:
        return None if self._socket is None else self._socket.fileno()

    @property
    def writes(self) -> bool:
        return self._connecting

    def read(self) -> Iterator[tuple[bytes, int]]:
        if self._socket is None:
            return
        if self._connecting and not self._connected():
            return
        try:
            data = self._socket.recv(_LARGEST)
        except BlockingIOError:
            return
        except OSError as error:
            self._broke(str(error))
            return
        if not data:
            self._broke("closed by the server")
            return
        self._heard_s = time.monotonic()
        yield data, self._clock.now_ns()

    def tend(self) -> None:
        if self._socket is not None and time.monotonic() - self._heard_s > _SILENT_S:
            self._broke("no answer" if self._connecting else "silent")
        if self._socket is None and self.due:
            self._connect()

    def close(self) -> None:
        self._connecting = False
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connect(self) -> None:
        try:
            family = socket.AF_INET6 if ":" in self._settings.host else socket.AF_INET
            self._socket = socket.socket(family, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
            failed = self._socket.connect_ex((self._settings.host, self._settings.port))
        except OSError as error:
            self._broke(str(error))
            return
        self._connecting, self._heard_s = True, time.monotonic()
        if failed not in (0, errno.EINPROGRESS):
            self._broke(os.strerror(failed))

    def _connected(self) -> bool:
        assert self._socket is not None
        failed = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if failed:
            self._broke(os.strerror(failed))
            return False
        self._connecting = False
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self.back()
        return True

    def _broke(self, detail: str) -> None:
        self.close()
        self.lost(detail)
