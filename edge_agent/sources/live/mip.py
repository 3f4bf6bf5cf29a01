"""MicroStrain's MIP (3DM-GX5, CV7 data communications protocols): a stream of packets -> IMU samples.

A packet is 0x75 0x65, a descriptor set, the payload's length, fields (length, descriptor, data; big endian) and a
checksum (Fletcher's, modulo 256, over all before it).
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate, groupby

import numpy as np

from edge_agent.sources.live.feed import Reading
from edge_agent.sources.live.sensor_clock import SensorClock, TimeBase
from edge_agent.sources.live.smoothing import SmoothedArrivals
from edge_agent.sources.source import Counts
from splitslam.scan import ImuSamples

_LONGEST_NS = 1 << 62  # a time beyond is none, whosever it is
SYNC = b"\x75\x65"
_HEAD, _CHECK = 4, 2
_SENSOR_DATA = 0x80
_ACCEL, _GYRO = 0x04, 0x05
_GPS_TIME, _SHARED_GPS_TIME, _REFERENCE_TIME = 0x12, 0xD3, 0xD5
_VECTOR, _GPS, _NS = struct.Struct(">3f"), struct.Struct(">dHH"), struct.Struct(">Q")
_LENGTHS = {_ACCEL: 12, _GYRO: 12, _GPS_TIME: 12, _SHARED_GPS_TIME: 12, _REFERENCE_TIME: 8}
_LOCKED_FLAGS = {_GPS_TIME: 0b101, _SHARED_GPS_TIME: 0b011}  # pulse good and time initialised; time and week valid
_STANDARD_GRAVITY_MPS2 = 9.80665  # of the g that the sensor scales by
_GPS_EPOCH_S, _LEAP_S, _WEEK_S = 315_964_800, 18, 604_800  # GPS time is ahead of UTC by 18 s since 2017


@dataclass(frozen=True, slots=True)
class _Sample:
    """stamp_ns: on the sensor's clock, None: it has none. locked: that clock is GPS'."""

    gyro_radps: tuple[float, float, float]
    accel_mps2: tuple[float, float, float]
    stamp_ns: int | None
    base: TimeBase


class MipFeed:
    """A serial device's bytes, whatever they begin with.

    counts: packets, used (a sample), unused (other data), checksum (wrong), garbage (bytes between packets).
    """

    def __init__(self, clock: SensorClock, time_offset_ns: int, counts: Counts, dropped: Counter[str]) -> None:
        self.counts: Counter[str] = Counter()
        self._clock, self._time_offset_ns = clock, time_offset_ns
        self._read, self._dropped = counts, dropped
        self._rest = b""
        self._arrivals = SmoothedArrivals()
        self._in_gps_time = False

    def take(self, data: bytes, arrival_ns: int) -> Iterator[Reading]:
        """What the device had."""
        samples = [sample for packet in self._packets(data) if (sample := self._sample(packet)) is not None]
        for _, of_one_clock in groupby(samples, key=lambda sample: sample.base):
            yield self._reading(list(of_one_clock), arrival_ns)

    def _reading(self, samples: list[_Sample], arrival_ns: int) -> Reading:
        stamps_ns = [sample.stamp_ns for sample in samples]
        known = [stamp_ns for stamp_ns in stamps_ns if stamp_ns is not None]
        if len(known) < len(samples):
            known = self._arrivals.stamps_ns(len(samples), arrival_ns)
        self._clock.heard(known[-1], arrival_ns, samples[-1].base)
        self._read.imu_messages += len(samples)
        return Reading(
            "imu",
            self._clock,
            ImuSamples(
                np.array(known, dtype=np.int64) + self._time_offset_ns,
                np.array([sample.gyro_radps for sample in samples]),
                np.array([sample.accel_mps2 for sample in samples]),
            ),
        )

    def quiet(self) -> Iterator[Reading]:
        """Nothing is held back."""
        return iter(())

    def _packets(self, data: bytes) -> Iterator[memoryview]:
        """The payloads of sensor data packets, as far as they are complete."""
        buffer = self._rest + data
        view, at = memoryview(buffer), 0
        while True:
            found = buffer.find(SYNC, at)
            if found < 0:
                found = len(buffer) - 1 if buffer.endswith(SYNC[:1]) else len(buffer)
            self.counts["garbage"] += max(found - at, 0)
            at = max(found, at)
            if at + _HEAD > len(buffer):
                break
            end = at + _HEAD + buffer[at + 3] + _CHECK
            if end > len(buffer):
                break
            if not _is_whole(buffer, at, end):
                self.counts["checksum"] += 1
                self.counts["garbage"] += 1
                at += 1  # its own sync bytes may be chance, and the true ones inside
                continue
            if buffer[at + 2] == _SENSOR_DATA:
                yield view[at + _HEAD : end - _CHECK]
            else:
                self.counts["unused"] += 1
            at = end
        self._rest = buffer[at:]

    def _sample(self, payload: memoryview) -> _Sample | None:
        fields = dict(_fields(payload))
        accel, gyro = fields.get(_ACCEL), fields.get(_GYRO)
        if accel is None or gyro is None:
            self.counts["unused"] += 1
            return None
        accel_g, gyro_radps = _VECTOR.unpack(accel), _VECTOR.unpack(gyro)
        self.counts["used"] += 1
        if not all(map(math.isfinite, (*accel_g, *gyro_radps))):
            self._dropped["imu_nan"] += 1
            return None
        stamp_ns, base = self._stamp(fields)
        x, y, z = (g * _STANDARD_GRAVITY_MPS2 for g in accel_g)
        return _Sample(gyro_radps, (x, y, z), stamp_ns, base)

    def _stamp(self, fields: dict[int, memoryview]) -> tuple[int | None, TimeBase]:
        """GPS' time while it is locked (while the run goes on also after), else the device's own, else none."""
        for kind, locked_flags in _LOCKED_FLAGS.items():
            if kind in fields:
                time_of_week_s, week, flags = _GPS.unpack(fields[kind])
                locked = flags & locked_flags == locked_flags
                self._in_gps_time = locked or (self._in_gps_time and bool(self._clock.chosen))
                if 0.0 <= time_of_week_s < _WEEK_S and self._in_gps_time:
                    since_s = _GPS_EPOCH_S - _LEAP_S + week * _WEEK_S
                    stamp_ns = since_s * 1_000_000_000 + round(time_of_week_s * 1e9)
                    if stamp_ns < _LONGEST_NS:
                        return stamp_ns, TimeBase.GPS if locked else TimeBase.OWN
        if _REFERENCE_TIME in fields:
            stamp_ns = _NS.unpack(fields[_REFERENCE_TIME])[0]
            if stamp_ns < _LONGEST_NS:
                return stamp_ns, TimeBase.OWN
        return None, TimeBase.NONE


def _is_whole(buffer: bytes, start: int, end: int) -> bool:
    """The checksum fits. Fletcher's second sum is that of all the first ones."""
    body = buffer[start : end - _CHECK]
    return buffer[end - 2] == sum(body) & 0xFF and buffer[end - 1] == sum(accumulate(body)) & 0xFF


def _fields(payload: memoryview) -> Iterator[tuple[int, memoryview]]:
    """(descriptor, data) of each field that we know, of the length that it has to have."""
    at = 0
    while at + 2 <= len(payload):
        length, kind = payload[at], payload[at + 1]
        if length < 2 or at + length > len(payload):
            return
        if _LENGTHS.get(kind) == length - 2:
            yield kind, payload[at + 2 : at + length]
        at += length
