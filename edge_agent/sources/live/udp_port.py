"""A UDP port, with what the kernel says of each packet."""

from __future__ import annotations

import logging
import socket
import struct
from collections import Counter
from collections.abc import Iterator

from edge_agent.sources.live.arrivals import ArrivalClock
from splitslam.errors import InputError
from splitslam.logs import fields

_log = logging.getLogger(__name__)

_SO_TIMESTAMPNS, _SO_RXQ_OVFL = 35, 40  # socket(7); Python has no names for them
_TIMESPEC, _COUNT = struct.Struct("qq"), struct.Struct("I")
_ANCILLARY = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_COUNT.size)
_LARGEST = 65535
_AT_ONCE = 512  # packets, before other ports get their turn


class UdpPort:
    """Packets with the kernel's time of arrival: the reader may be busy when they come.

    port: the one that it has. receive_bytes: the buffer that the system has granted.
    """

    writes = False

    def __init__(
        self, where: str, address: tuple[str, int], receive_bytes: int, sender: str | None, clock: ArrivalClock
    ) -> None:
        """where: the key in the configuration. Raises InputError when the port cannot be had."""
        self.counts: Counter[str] = Counter()
        self._clock, self._sender, self._overflows = clock, sender, 0
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise InputError(
                f"{where}: cannot listen on udp {address[0]}:{address[1]}: {error.strerror or error}; expected an"
                " address of this machine and a port that no other program has"
            ) from None
        self.port: int = self._socket.getsockname()[1]
        self.receive_bytes = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # socket(7): it doubles

    @property
    def fileno(self) -> int | None:
        return self._socket.fileno()

    def read(self) -> Iterator[tuple[bytes, int]]:
        for _ in range(_AT_ONCE):
            try:
                data, ancillary, _, address = self._socket.recvmsg(_LARGEST, _ANCILLARY)
            except BlockingIOError:
                return
            except OSError as error:  # such as an ICMP error of another program's packet
                _log.debug("udp port", extra=fields(detail=str(error)))
                return
            arrival_ns = self._arrival_ns(ancillary)
            if self._sender is not None and address[0] != self._sender:
                self.counts["sender"] += 1
                continue
            yield data, arrival_ns

    def _arrival_ns(self, ancillary: list[tuple[int, int, bytes]]) -> int:
        arrival_ns = None
        for _, kind, value in ancillary:
            if kind == _SO_TIMESTAMPNS:
                seconds, rest_ns = _TIMESPEC.unpack(value[: _TIMESPEC.size])
                arrival_ns = self._clock.of_wall_ns(seconds * 1_000_000_000 + rest_ns)
            elif kind == _SO_RXQ_OVFL:
                (overflows,) = _COUNT.unpack(value[: _COUNT.size])
                self.counts["overflow"] += (overflows - self._overflows) % 2**32
                self._overflows = overflows
        return self._clock.now_ns() if arrival_ns is None else arrival_ns

    def tend(self) -> None:
        """A UDP port stays open."""

    def close(self) -> None:
        self._socket.close()
