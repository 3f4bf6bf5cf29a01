"""Sends the packets of a capture again, as the sensor did: for tests of a live agent, and for want of a sensor."""

from __future__ import annotations

import random
import socket
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from splitslam.pcap import Datagram


@dataclass(frozen=True, slots=True)
class Faults:
    """What a bad network does to packets, each with a probability. late: a packet changes places with the next one."""

    lost: float = 0.0
    twice: float = 0.0
    late: float = 0.0
    seed: int = 0


def with_faults(datagrams: Iterable[Datagram], faults: Faults, done: Counter[str]) -> Iterator[Datagram]:
    """The datagrams that get through; done: how many were lost, sent twice, late."""
    chance = random.Random(faults.seed)
    held: Datagram | None = None
    for datagram in datagrams:
        if chance.random() < faults.lost:
            done["lost"] += 1
            continue
        if held is None and chance.random() < faults.late:
            done["late"] += 1
            held = datagram
            continue
        yield datagram
        if held is not None:
            yield held
            held = None
        if chance.random() < faults.twice:
            done["twice"] += 1
            yield datagram
    if held is not None:
        yield held


def send(datagrams: Iterable[Datagram], host: str, ports: Mapping[int, int], speed: float | None = 1.0) -> Counter[int]:
    """Sends them to `host`, and says how many went to each port of the capture.

    ports: of the capture -> to send to; others keep theirs. speed: 1 as captured, None as fast as it goes.
    """
    sent: Counter[int] = Counter()
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as out:
        out.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 * 2**20)
        began_s, first_ns = time.monotonic(), None
        for datagram in datagrams:
            first_ns = datagram.stamp_ns if first_ns is None else first_ns
            if speed is not None:
                due_s = began_s + (datagram.stamp_ns - first_ns) * 1e-9 / speed
                time.sleep(max(due_s - time.monotonic(), 0.0))
            out.sendto(datagram.data, (host, ports.get(datagram.port, datagram.port)))
            sent[datagram.port] += 1
    return sent
