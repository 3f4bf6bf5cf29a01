"""A Velodyne's data and position packets -> scans (VLP-16 user manual 63-9243, chapter 9)."""

from __future__ import annotations

import logging
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from edge_agent.sources.live import nmea
from edge_agent.sources.live.feed import Reading
from edge_agent.sources.live.sensor_clock import SensorClock, TimeBase
from edge_agent.sources.live.turns import PACKET_BYTES, Packet, Turns, unwrapped
from edge_agent.sources.raw import Gate
from edge_agent.sources.source import Counts
from edge_agent.sources.velodyne import SENSOR_OF_CODE, VelodyneDecoder
from splitslam.errors import DataError
from splitslam.logs import fields
from splitslam.robot import Robot

_log = logging.getLogger(__name__)

POSITION_BYTES = 512
_POSITION = struct.Struct("<IB")  # microseconds since the hour, state of the pulse per second
_POSITION_AT, _NMEA_AT, _NMEA_BYTES = 198, 206, 128
_LOCKED = 2
_FRESH_NS = 3_000_000_000  # for so long the last position packet speaks for the time
_BLOCK_FLAGS = (b"\xff\xee", b"\xff\xdd")


@dataclass(frozen=True, slots=True)
class _Fixed:
    """The last position packet that was locked: UTC of it, and when it came, ns."""

    utc_ns: int
    arrival_ns: int


class PositionFeed:
    """The position packets: they say which hour the data packets' microseconds belong to, once PPS is locked."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._sentence = b""
        self._rmc_ns: int | None = None
        self._fixed: _Fixed | None = None

    def take(self, data: bytes, arrival_ns: int) -> tuple[Reading, ...]:
        """One packet."""
        if len(data) != POSITION_BYTES:
            self.counts["size"] += 1
            return ()
        microseconds, pps = _POSITION.unpack_from(data, _POSITION_AT)
        sentence = data[_NMEA_AT : _NMEA_AT + _NMEA_BYTES].partition(b"\0")[0].strip()
        if sentence != self._sentence:
            self._sentence, self._rmc_ns = sentence, nmea.valid_rmc_ns(sentence)
        self.counts["used"] += 1
        self._fixed = None
        if pps == _LOCKED and self._rmc_ns is not None:
            self._fixed = _Fixed(unwrapped(microseconds * 1000, self._rmc_ns), arrival_ns)
        return ()

    def quiet(self) -> tuple[Reading, ...]:
        """Nothing is held back."""
        return ()

    def utc_ns(self, arrival_ns: int) -> int | None:
        """UTC of what came at `arrival_ns`, to some ms; None when the sensor has not said lately that it is locked."""
        fixed = self._fixed
        if fixed is None or not -_FRESH_NS < arrival_ns - fixed.arrival_ns < _FRESH_NS:
            return None
        return fixed.utc_ns + arrival_ns - fixed.arrival_ns


class VelodyneFeed:
    """The data packets, cut into turns and decoded; stamps are UTC while PPS is locked, else of the nearest hour."""

    def __init__(
        self, robot: Robot, clock: SensorClock, position: PositionFeed, counts: Counts, dropped: Counter[str]
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._model = robot.lidar.model
        self._clock, self._position, self._dropped = clock, position, dropped
        self._turns = Turns(self._model, robot.lidar.rate_hz, self.counts)
        self._decoder = VelodyneDecoder(self._model)
        self._gate, self._read = Gate(robot, counts.left_out), counts
        self._told_model = False

    def take(self, data: bytes, arrival_ns: int) -> Iterator[Reading]:
        """One packet."""
        if len(data) != PACKET_BYTES:
            self.counts["size"] += 1
            return
        if data[:2] not in _BLOCK_FLAGS:
            self.counts["foreign"] += 1
            return
        if not self._is_ours(data):
            self.counts["model"] += 1
            return
        utc_ns = self._position.utc_ns(arrival_ns)
        turns = self._turns.add(data, arrival_ns if utc_ns is None else utc_ns, known=utc_ns is not None)
        for turn in turns:  # of before this packet, whose time may be another
            yield from self._decoded(turn)
        base = TimeBase.OWN if utc_ns is None else TimeBase.GPS
        self._clock.heard(self._turns.newest_ns + self._turns.step_ns, arrival_ns, base)

    def quiet(self) -> Iterator[Reading]:
        """The turn that has begun goes as far as it has come."""
        for turn in self._turns.flush():
            yield from self._decoded(turn)

    def _is_ours(self, data: bytes) -> bool:
        sensor = SENSOR_OF_CODE.get(data[-1])
        if sensor is None or sensor == self._model:
            return True
        if not self._told_model:
            _log.error("packets of another lidar", extra=fields(found=sensor, expected=self._model))
            self._told_model = True
        return False

    def _decoded(self, turn: list[Packet]) -> Iterator[Reading]:
        self._read.scans_read += 1
        self._read.native_bytes += PACKET_BYTES * len(turn)
        stamps_ns = np.array([packet.sensor_ns for packet in turn], dtype=np.int64)
        try:
            scan = self._gate(self._decoder.decode([packet.data for packet in turn], stamps_ns))
        except DataError as error:
            self._dropped[error.reason] += 1
            said = fields(reason=error.reason, detail=error.detail)
            _log.warning("scan not decoded", extra=said)
            return
        self._read.read_points += len(scan)
        yield Reading("lidar", self._clock, scan, tuple(turn))
