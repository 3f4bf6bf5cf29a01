"""TCP payload that this process has exchanged with one server, framing included, as the kernel counted it.

gRPC does not say what HTTP/2 costs, so the sockets are asked. Each is duplicated when first seen: the counters then
outlive gRPC's own close, and no sampling thread is needed (gRPC shuts a socket down before it closes it, so the
duplicate keeps no connection open).
"""

from __future__ import annotations

import os
import socket
import struct
import threading
from dataclasses import dataclass

# struct tcp_info (linux/tcp.h): u64 bytes_acked, bytes_received; later kernels add bytes_sent, bytes_retrans.
_ACKED, _SENT = 120, 200
_TCP_INFO_BYTES = 256


@dataclass(frozen=True, slots=True)
class TcpBytes:
    """Payload bytes without retransmissions."""

    sent: int = 0
    received: int = 0

    def __add__(self, other: TcpBytes) -> TcpBytes:
        return TcpBytes(self.sent + other.sent, self.received + other.received)


class TcpMeter:
    """Sums over this process's connections to `host:port` of one kind, past ones included.

    dscp: the kind, by what their packets are marked with: 0 for live ones.
    """

    def __init__(self, host: str, port: int, dscp: int = 0) -> None:
        self._host, self._port, self._dscp = host, port, dscp
        self._open: dict[int, socket.socket] = {}  # by socket inode
        self._past = TcpBytes()
        self._lock = threading.Lock()

    def discover(self) -> None:
        """Looks for new connections; call it once a connection is up, and before it is closed."""
        peers = _addresses(self._host)
        with self._lock:
            for name in os.listdir("/proc/self/fd"):
                self._consider(name, peers)

    def _consider(self, name: str, peers: set[str]) -> None:
        try:
            target = os.readlink(f"/proc/self/fd/{name}")
            if not target.startswith("socket:[") or (inode := int(target[8:-1])) in self._open:
                return
            twin = socket.socket(fileno=os.dup(int(name)))
        except OSError:  # the descriptor went away while we looked
            return
        if _is_tcp_to(twin, peers, self._port) and _dscp(twin) == self._dscp:
            self._open[inode] = twin
        else:
            twin.close()

    def read(self) -> TcpBytes:
        """Bytes so far."""
        with self._lock:
            return sum((_tcp_bytes(twin) for twin in self._open.values()), self._past)

    def settle(self) -> None:
        """Books the connections and lets go of them; their last few bytes may still be under way."""
        with self._lock:
            for twin in self._open.values():
                self._past += _tcp_bytes(twin)
                twin.close()
            self._open.clear()


def _addresses(host: str) -> set[str]:
    try:
        return {str(info[4][0]) for info in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)}
    except OSError:
        return {host}


def _is_tcp_to(sock: socket.socket, peers: set[str], port: int) -> bool:
    if sock.family not in (socket.AF_INET, socket.AF_INET6) or sock.type != socket.SOCK_STREAM:
        return False
    try:
        address, peer_port = sock.getpeername()[:2]
    except OSError:
        return False
    return peer_port == port and address.removeprefix("::ffff:") in peers


def _dscp(sock: socket.socket) -> int:
    if sock.family == socket.AF_INET:
        return sock.getsockopt(socket.IPPROTO_IP, socket.IP_TOS) >> 2
    return sock.getsockopt(socket.IPPROTO_IPV6, socket.IPV6_TCLASS) >> 2


def _tcp_bytes(sock: socket.socket) -> TcpBytes:
    info = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO_BYTES)
    acked, received = struct.unpack_from("<QQ", info, _ACKED)
    if len(info) >= _SENT + 16:
        sent, resent = struct.unpack_from("<QQ", info, _SENT)
        return TcpBytes(sent - resent, received)
    return TcpBytes(max(0, acked - 1), received)  # the SYN counts as one acknowledged byte
