"""A Velodyne's packets put in order and cut into turns.

Packets are numbered by nothing but their time, the sensor's microseconds since the full hour. A turn ends where the
azimuth wraps, at a packet's boundary, as the ROS drivers cut, so that a turn begins with its first firing.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

PACKET_BYTES = 1206
DUAL_RETURN = 0x39
HOUR_NS = 3_600_000_000_000
_STEP_NS = {"vlp16": 1_327_104, "hdl32": 552_960}  # from packet to packet, one return (user manuals)
_PATIENCE = 2  # packets after the wrap that are waited for, should one of before come late
_TAIL = struct.Struct("<IBB")
_AZIMUTH = struct.Struct("<H")
FULL_TURN = 36_000  # of 0.01 deg
_MUCH = 0.5  # of a turn, that is lost in one piece
_RESTART_NS = 1_000_000_000
_LONGEST_NS = 2_000_000_000  # of a turn: beyond, the sensor does not turn at all, and no scan would ever end
_BREAK = 4  # packets: more than that when a lock comes or goes is a step, and a turn is of one time


@dataclass(frozen=True, slots=True)
class Packet:
    """sensor_ns: first firing, on the sensor's clock made endless. azimuth: of the first block, 0.01 deg."""

    sensor_ns: int
    azimuth: int
    data: bytes


class Turns:
    """Packets in, complete turns out.

    newest_ns: first firing of the packet added last. step_ns: from one packet to the next.
    counts: packets by what became of them: used (in a turn), duplicate, late (their turn is gone), start (of a turn
    whose beginning nobody saw), and besides, reordered (used, but came late) and lost (by gaps in time).
    """

    def __init__(self, model: str, rate_hz: float, counts: Counter[str]) -> None:
        self._single_ns = self.step_ns = _STEP_NS[model]
        self.newest_ns = 0
        self._turn_ns = 1e9 / rate_hz
        self.counts = counts
        self._known = False  # the time of the newest packet was by the sensor itself
        self._packets: list[Packet] = []  # by time
        self._whole = False  # the turn in `_packets` began at its wrap
        self._done_ns: int | None = None  # newest packet of the turn before

    def add(self, data: bytes, near_ns: int, known: bool = False) -> list[list[Packet]]:
        """The turns that this packet completes, none or one mostly.

        near_ns: about the time of the packet, to know the hour by; known: it is by the sensor itself, not a guess.
        """
        microseconds, mode, _ = _TAIL.unpack_from(data, PACKET_BYTES - _TAIL.size)
        self.step_ns = self._single_ns // (2 if mode == DUAL_RETURN else 1)
        sensor_ns = unwrapped(microseconds * 1000, near_ns if known or self.newest_ns == 0 else self.newest_ns)
        packet = Packet(sensor_ns, _AZIMUTH.unpack_from(data, 2)[0], data)
        done: list[list[Packet]] = []
        limit_ns = _RESTART_NS if known is self._known else _BREAK * self.step_ns
        if self.newest_ns and abs(sensor_ns - self.newest_ns) > limit_ns:
            done += self.flush()  # silence, or the sensor's clock has stepped
            self._done_ns = None
        elif self._packets and sensor_ns - self._packets[0].sensor_ns > _LONGEST_NS:
            done += self.flush()
        self._known = known
        self.newest_ns = sensor_ns
        if not self._insert(packet):
            return done
        while (end := self._end()) is not None:
            turn, self._packets = self._packets[:end], self._packets[end:]
            done += self._finish(turn)
            self._whole = True
        return done

    def flush(self) -> list[list[Packet]]:
        """The turn that has begun, when nothing more comes."""
        turn, self._packets = self._packets, []
        done = self._finish(turn) if turn else []
        self._whole = False
        return done

    def _insert(self, packet: Packet) -> bool:
        if self._done_ns is not None and packet.sensor_ns <= self._done_ns:
            self.counts["duplicate" if packet.sensor_ns == self._done_ns else "late"] += 1
            return False
        place = bisect_right(self._packets, packet.sensor_ns, key=lambda p: p.sensor_ns)
        if place > 0 and self._packets[place - 1].sensor_ns == packet.sensor_ns:
            self.counts["duplicate"] += 1
            return False
        if place < len(self._packets):
            self.counts["reordered"] += 1
        self._packets.insert(place, packet)
        return True

    def _end(self) -> int | None:
        """Where the first turn ends, as soon as it is certain."""
        packets = self._packets
        for k in range(max(1, len(packets) - _PATIENCE - 1), len(packets) - _PATIENCE + 1):
            if self._wraps(packets[k - 1], packets[k]):
                return k
        return None

    def _wraps(self, packet: Packet, after: Packet) -> bool:
        """Azimuth zero lies between them; by time where most of a turn was lost."""
        if packet.azimuth > after.azimuth:
            return True
        turned = (after.sensor_ns - packet.sensor_ns) / self._turn_ns
        return turned > _MUCH and packet.azimuth / FULL_TURN + turned > 1.0

    def _finish(self, turn: list[Packet]) -> list[list[Packet]]:
        before_ns = self._done_ns
        self._done_ns = turn[-1].sensor_ns
        times = [packet.sensor_ns for packet in turn]
        if before_ns is not None:
            times.insert(0, before_ns)
        self.counts["lost"] += sum(max(round((b - a) / self.step_ns) - 1, 0) for a, b in pairwise(times))
        if not self._whole:
            self.counts["start"] += len(turn)
            return []
        self.counts["used"] += len(turn)
        return [turn]


def unwrapped(since_hour_ns: int, near_ns: int) -> int:
    """The time nearest to `near_ns` with this much since the full hour."""
    return near_ns + (since_hour_ns - near_ns + HOUR_NS // 2) % HOUR_NS - HOUR_NS // 2
