"""What a sensor's bytes become."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from edge_agent.sources.live.sensor_clock import SensorClock
from edge_agent.sources.live.turns import Packet
from edge_agent.sources.source import Event


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """A sensor's message with stamps of its own clock. packets: of a Velodyne's turn, as they came."""

    sensor: str
    clock: SensorClock
    event: Event
    packets: tuple[Packet, ...] = ()


class Feed(Protocol):
    """The bytes of one port, decoded. counts: packets by what became of them; dropped: messages, by reason."""

    counts: Counter[str]

    def take(self, data: bytes, arrival_ns: int) -> Iterable[Reading]:
        """A packet, or what a stream had. What cannot be used is counted."""
        ...

    def quiet(self) -> Iterable[Reading]:
        """Nothing has come for a while: what is held back for later may go."""
        ...
