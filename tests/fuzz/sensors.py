"""What live sensors send, damaged: serial streams, UDP packets, captures of them."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from edge_agent.sources.live.mip import MipFeed
from edge_agent.sources.live.nmea import NmeaFeed
from edge_agent.sources.live.sensor_clock import SensorClock
from edge_agent.sources.live.velodyne import PositionFeed, VelodyneFeed
from edge_agent.sources.source import Counts
from splitslam.errors import InputError
from splitslam.pcap import datagrams
from tests.fuzz.mutate import Rng, mutated
from tests.fuzz.target import Target, scratch
from tests.live import made, wire

_STEP_NS = 10_000_000
_PIECES = 12
_DAMAGED = (0.0, 0.05, 0.5)  # share of a stream's pieces
_TURN = 160  # packets: two turns of a VLP-16

_NO_USE = ("garbage", "checksum", "size", "foreign", "model")

Arrivals = list[tuple[int, bytes]]


class _CountedError(Exception):
    """The stream's way to refuse."""


def mip() -> Target:
    seeds = [b"".join(made.mip_sample(reference_ns=2_000_000 * (3 * n + k)) for k in range(3)) for n in range(4)]
    seeds.append(made.mip_sample(gps=(345_600.0, 2300, 7)) + made.mip_packet({0x01: b"", 0x04: bytes(12)}))
    return _stream("mip", seeds, lambda: MipFeed(SensorClock("imu"), 0, Counts(), Counter()))


def nmea() -> Target:
    seeds = [
        (
            made.gga(f"1235{n:02d}.00")
            + made.gst(f"1235{n:02d}.00", 1.0, 1.2, 2.0)
            + made.rmc(f"1235{n:02d}.00", "230394")
        ).encode()
        for n in range(8)
    ]
    return _stream("nmea", seeds, lambda: NmeaFeed(SensorClock("gnss"), Counter()))


def _stream(name: str, seeds: list[bytes], open_feed: Callable[[], Any]) -> Target:
    """Bytes of a serial device: it is read to the end whatever they are."""

    def make(rng: Rng) -> Arrivals:
        share = rng.choice(_DAMAGED)
        pieces = [mutated(seeds, rng) if rng.random() < share else seeds[n % len(seeds)] for n in range(_PIECES)]
        return [(_STEP_NS * n, piece) for n, piece in enumerate(pieces)]

    def feed(given: Arrivals) -> None:
        _read(open_feed(), given)

    return Target(name, make, feed, (_CountedError,))


def udp_packets() -> Target:
    """A Velodyne's two ports: data and position packets."""
    robot = wire.velodyne_robot("vlp16")
    data = [made.data_packet(n) for n in range(_TURN)]
    positions = [made.position_packet(1_000_000 * n, made.rmc(f"1235{n:02d}", "230394")) for n in range(4)]

    def make(rng: Rng) -> tuple[Arrivals, Arrivals]:
        share = rng.choice(_DAMAGED)
        packets = [mutated([packet], rng) if rng.random() < share else packet for packet in data]
        return (
            [(1_327_104 * n, packet) for n, packet in enumerate(packets)],
            [(50_000_000 * n, mutated(positions, rng)) for n in range(4)],
        )

    def feed(given: tuple[Arrivals, Arrivals]) -> None:
        position = PositionFeed()
        with suppress(_CountedError):
            _read(position, given[1])
        lidar = VelodyneFeed(robot, SensorClock("lidar"), position, Counts(), Counter())
        _read(lidar, given[0])

    return Target("udp packets", make, feed, (_CountedError,))


def _read(feed: Any, arrivals: Arrivals) -> None:
    """A stream goes on whatever comes; _CountedError, once it is read, when some of it was counted as no use."""
    for arrival_ns, data in arrivals:
        for _ in feed.take(data, arrival_ns):
            pass
    for _ in feed.quiet():
        pass
    if any(feed.counts[reason] for reason in _NO_USE):
        raise _CountedError(dict(feed.counts))


def captures() -> Target:
    """pcap files, as `splitslam replay` reads them."""
    folder, remove = scratch()
    whole = _pcap([made.data_packet(n) for n in range(6)])

    def make(rng: Rng) -> bytes:
        start = 24 if rng.random() < 0.9 else 0
        return whole[:start] + mutated([whole[start:]], rng)

    def feed(given: bytes) -> None:
        (path := folder / "damaged.pcap").write_bytes(given)
        for datagram in datagrams(path):
            assert isinstance(datagram.data, bytes)

    return Target("captures", make, feed, (InputError,), remove)


def _pcap(payloads: list[bytes]) -> bytes:
    """Ethernet, IPv4 and UDP around each, in a file as tcpdump writes it."""

    def records() -> Iterator[bytes]:
        yield struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
        for n, payload in enumerate(payloads):
            udp = struct.pack(">HHHH", 2368, 2368, 8 + len(payload), 0) + payload
            header = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(udp), n, 0, 64, 17, 0, b"\x7f\0\0\1", b"\x7f\0\0\1")
            frame = bytes(12) + b"\x08\x00" + header + udp
            yield struct.pack("<IIII", n, 0, len(frame), len(frame)) + frame

    return b"".join(records())
