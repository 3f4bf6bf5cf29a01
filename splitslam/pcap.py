"""UDP datagrams out of a packet capture, put together again where IP has cut them up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import dpkt

from splitslam.errors import InputError

_EXPECTED = "expected a capture as tcpdump or Wireshark writes it (.pcap, .pcapng)"


@dataclass(frozen=True, slots=True)
class Datagram:
    """stamp_ns: of its last fragment in the capture. port: where it was sent to."""

    stamp_ns: int
    port: int
    data: bytes


def datagrams(path: Path) -> Iterator[Datagram]:
    """Every UDP datagram of a capture, in order. Raises InputError: missing, or not a capture."""
    try:
        file = path.open("rb")
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}; {_EXPECTED}") from error
    with file:
        reader = _reader(path, file)
        fragments = _Fragments()
        try:
            for stamp_s, frame in reader:
                packet = _ip_of(frame, reader.datalink())
                whole = None if packet is None else fragments.add(packet)
                if whole is not None:
                    yield Datagram(round(stamp_s * 1e9), *whole)
        except (dpkt.dpkt.Error, ValueError) as error:
            raise InputError(f"{path}: damaged capture: {error}") from error


def _reader(path: Path, file: BinaryIO) -> Any:
    try:
        return dpkt.pcap.UniversalReader(file)
    except (ValueError, dpkt.dpkt.Error):
        raise InputError(f"{path}: not a capture; {_EXPECTED}") from None


def _ip_of(frame: bytes, link: int) -> Any | None:
    """The IPv4 packet in a frame; None for anything else."""
    try:
        if link == dpkt.pcap.DLT_EN10MB:
            packet = dpkt.ethernet.Ethernet(frame).data
        elif link == dpkt.pcap.DLT_LINUX_SLL:
            packet = dpkt.sll.SLL(frame).data
        elif link == dpkt.pcap.DLT_RAW:
            packet = dpkt.ip.IP(frame)
        else:
            return None
    except dpkt.dpkt.Error:
        return None
    is_udp = isinstance(packet, dpkt.ip.IP) and getattr(packet, "p", None) == dpkt.ip.IP_PROTO_UDP
    return packet if is_udp else None


class _Fragments:
    """Datagrams whose fragments have not all come (RFC 791, section 3.2)."""

    def __init__(self) -> None:
        self._parts: dict[tuple[bytes, bytes, int], dict[int, bytes]] = {}
        self._sizes: dict[tuple[bytes, bytes, int], int] = {}

    def add(self, packet: Any) -> tuple[int, bytes] | None:
        """(port, data) of the datagram that this one completes."""
        offset, more = 8 * int(packet.offset), bool(packet.mf)
        if offset == 0 and not more:
            return _udp(bytes(packet.data))
        key = (packet.src, packet.dst, packet.id)
        parts = self._parts.setdefault(key, {})
        parts[offset] = bytes(packet.data)
        if not more:
            self._sizes[key] = offset + len(parts[offset])
        if sum(map(len, parts.values())) != self._sizes.get(key):
            return None
        del self._parts[key], self._sizes[key]
        return _udp(b"".join(parts[at] for at in sorted(parts)))


def _udp(data: bytes) -> tuple[int, bytes]:
    """(destination port, payload)."""
    datagram: Any = dpkt.udp.UDP(data)
    return int(datagram.dport), bytes(datagram.data)
