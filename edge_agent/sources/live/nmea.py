"""NMEA 0183 from a GNSS receiver -> fixes. Sentences are parsed by pynmeagps."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime, time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pynmeagps import NMEAMessageError, NMEAParseError, NMEAReader, NMEAStreamError, NMEATypeError

from edge_agent.sources.live.feed import Reading
from edge_agent.sources.live.sensor_clock import SensorClock, TimeBase
from splitslam.scan import GnssFix

_DAY_NS = 86_400_000_000_000
_FIELDS = {
    "GGA": ("time", "quality", "lat", "lon", "alt", "sep", "HDOP"),
    "GST": ("time", "stdLat", "stdLong", "stdAlt"),
    "RMC": ("time", "status", "date"),
}
_REFUSALS = (NMEAMessageError, NMEAParseError, NMEAStreamError, NMEATypeError)
_LONGEST = 1024  # bytes without an end of line: no NMEA
# Standard deviation along each horizontal axis at HDOP 1, m, by GGA's quality: single point, differential, PPS, RTK
# fixed, RTK float, simulator. Others (none, dead reckoning, typed in) are no measurement of satellites.
_SIGMA_M = {1: 3.0, 2: 1.0, 3: 3.0, 4: 0.02, 5: 0.5, 8: 3.0}
_STATUS = {2: 1, 4: 2, 5: 2}  # NavSatStatus: augmented by satellites, by ground stations; else 0
_VERTICAL = 2.0  # of the horizontal sigma: satellites are all above


def parse(sentence: bytes) -> Any | None:
    """The message, or None when it is none, its checksum is wrong, or fields that it should have are missing."""
    try:
        message = NMEAReader.parse(sentence)
    except (*_REFUSALS, ValueError, TypeError, KeyError, IndexError, AttributeError):
        return None  # the parser trips over more than it says
    if message is None or not all(hasattr(message, field) for field in _FIELDS.get(message.msgID, ())):
        return None
    return message


def valid_rmc_ns(sentence: bytes) -> int | None:
    """UTC, ns, that a $..RMC with a valid fix says; None for anything else."""
    message = parse(sentence)
    if message is None or message.msgID != "RMC" or message.status != "A":
        return None
    if not isinstance(message.date, date) or not isinstance(message.time, time):
        return None
    moment = datetime.combine(message.date, message.time, tzinfo=UTC)
    return int(moment.replace(microsecond=0).timestamp()) * 1_000_000_000 + moment.microsecond * 1000


@dataclass(slots=True)
class _Epoch:
    """What the receiver has said of one moment. of_day_ns: since midnight."""

    of_day_ns: int
    position: Any = None  # GGA
    noise: Any = None  # GST


class NmeaFeed:
    """A receiver's bytes: GGA for the place, RMC for the date, GST for its errors where it sends them.

    counts: sentences, used or unused, checksum (or not to be parsed), garbage (bytes that are no sentence, in pieces).
    """

    def __init__(self, clock: SensorClock, dropped: Counter[str]) -> None:
        self.counts: Counter[str] = Counter()
        self._clock, self._dropped = clock, dropped
        self._rest = b""
        self._date_ns: int | None = None  # UTC that an RMC said last
        self._epoch: _Epoch | None = None
        self._sends_gst = False
        self._came_ns = 0  # the newest bytes

    def take(self, data: bytes, arrival_ns: int) -> Iterator[Reading]:
        """What the line had."""
        self._came_ns = arrival_ns
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > _LONGEST:
            self._rest = b""
            self.counts["garbage"] += 1
        for line in lines:
            before, dollar, sentence = line.rpartition(b"$")
            if before:
                self.counts["garbage"] += 1
            if dollar:
                yield from self._sentence(dollar + sentence.rstrip(b"\r") + b"\r\n")

    def quiet(self) -> Iterator[Reading]:
        """A fix that waits for the receiver's word on its errors goes without."""
        yield from self._end_epoch()

    def _sentence(self, sentence: bytes) -> Iterator[Reading]:
        message = parse(sentence)
        if message is None:
            self.counts["checksum"] += 1
            return
        if message.msgID not in ("GGA", "GST", "RMC") or not isinstance(message.time, time):
            self.counts["unused"] += 1
            return
        self.counts["used"] += 1
        of_day_ns = _of_day_ns(message.time)
        if self._epoch is None or self._epoch.of_day_ns != of_day_ns:
            yield from self._end_epoch()
            self._epoch = _Epoch(of_day_ns)
        if message.msgID == "RMC":
            self._date_ns = valid_rmc_ns(sentence)
        elif message.msgID == "GGA":
            self._epoch.position = message
        else:
            self._epoch.noise, self._sends_gst = message, True
        if self._epoch.position is not None and (self._epoch.noise is not None or not self._sends_gst):
            yield from self._end_epoch()

    def _end_epoch(self) -> Iterator[Reading]:
        epoch, self._epoch = self._epoch, None
        if epoch is None or epoch.position is None:
            return
        if epoch.noise is None:
            self._sends_gst = False
        quality = _whole(epoch.position.quality)
        if quality not in _SIGMA_M or not isinstance(epoch.position.lat, float):
            self._dropped["gnss_no_fix"] += 1
            return
        near_ns = self._date_ns if self._date_ns is not None else self._came_ns
        stamp_ns = near_ns + (epoch.of_day_ns - near_ns + _DAY_NS // 2) % _DAY_NS - _DAY_NS // 2
        fix = _fix(stamp_ns, quality, epoch)
        if fix is None:
            self._dropped["gnss_nan"] += 1
            return
        base = TimeBase.OWN if self._date_ns is None else TimeBase.GPS
        self._clock.heard(stamp_ns, self._came_ns, base)
        yield Reading("gnss", self._clock, fix)


def _fix(stamp_ns: int, quality: int, epoch: _Epoch) -> GnssFix | None:
    position = epoch.position
    altitude_m = _number(position.alt) + (_number(position.sep) if position.sep != "" else 0.0)
    values = (_number(position.lat), _number(position.lon), altitude_m)
    if not all(map(math.isfinite, values)):
        return None
    covariance = None if epoch.noise is None else _covariance_of_gst(epoch.noise)
    if covariance is None:
        hdop = _number(position.HDOP)
        sigma_m = _SIGMA_M[quality] * (hdop if 0.0 < hdop < 50.0 else 1.0)
        covariance = np.diag(np.square([sigma_m, sigma_m, _VERTICAL * sigma_m]))
    return GnssFix(stamp_ns, *values, covariance, _STATUS.get(quality, 0))


def _covariance_of_gst(message: Any) -> NDArray[np.float64] | None:
    """(3, 3) m^2, east, north, up."""
    sigmas_m = np.array([_number(message.stdLong), _number(message.stdLat), _number(message.stdAlt)])
    return np.diag(np.square(sigmas_m)) if np.isfinite(sigmas_m).all() and (sigmas_m > 0).all() else None


def _of_day_ns(moment: time) -> int:
    seconds = (moment.hour * 60 + moment.minute) * 60 + moment.second
    return seconds * 1_000_000_000 + moment.microsecond * 1000


def _number(value: Any) -> float:
    """NaN for a field that is empty."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def _whole(value: Any) -> int:
    number = _number(value)
    return int(number) if math.isfinite(number) else 0
