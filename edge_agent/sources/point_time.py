"""What a PointCloud2's time field means, decided on the first scan and kept for the run.

All arithmetic on epochs is in float64 or integers: a float32 cannot hold a Unix time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitslam.errors import DataError

_UNITS_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
_NEVER_NS = 4e18  # the year 2096
_SAME_CLOCK_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class TimeMeaning:
    """unit_ns: ns per unit of the field. absolute: counts from the epoch of `header.stamp`'s clock.

    header: the instant `header.stamp` is when offsets are relative: `zero` (offset 0), `first` (smallest offset) or
    `end` (largest offset).
    """

    unit_ns: int
    absolute: bool
    header: str


@dataclass(frozen=True, slots=True, eq=False)
class PointTimes:
    """stamp_ns: first firing. end_ns: last. t_offset_ns: (N,) int64 after stamp_ns; bad: (N,) bool, time unusable."""

    stamp_ns: int
    end_ns: int
    t_offset_ns: NDArray[np.int64]
    bad: NDArray[np.bool_]


class PointClock:
    """Turns (header stamp, time field) into exact times for one stream."""

    def __init__(self, stamp: str, period_ns: int) -> None:
        self._stamp = stamp
        self._period_ns = period_ns
        self.meaning: TimeMeaning | None = None
        self.notes: list[str] = []

    def __call__(self, header_ns: int, time: NDArray[Any]) -> PointTimes:
        """header_ns: `header.stamp`. time: (N,) the field. DataError `point_time` when no time is usable."""
        if time.dtype.kind == "f":
            with np.errstate(invalid="ignore"):  # of NaN of any kind
                time = time.astype(np.float64, copy=False)
            good = np.isfinite(time)
        else:
            time = time.astype(np.int64)  # differences of the field's own type may not fit into it
            good = np.ones(len(time), dtype=bool)
        if self.meaning is None:
            self.meaning = self._decide(header_ns, time[good])
        meaning = self.meaning
        if meaning.absolute:
            good &= time > 0  # drivers leave zeros at missing returns
        if not good.any():
            raise DataError("point_time", "no point has a usable time")
        first = time[good].min()  # exact: the difference of near values loses nothing
        offset = np.where(good, time, first) - first
        if offset.dtype.kind == "f":
            t_ns = np.rint(np.minimum(offset * meaning.unit_ns, _NEVER_NS)).astype(np.int64)
            first_ns = _float_to_ns(float(first), meaning.unit_ns)
        else:
            t_ns = offset.astype(np.int64) * meaning.unit_ns
            first_ns = int(first) * meaning.unit_ns
        span_ns = int(t_ns.max())
        if meaning.absolute:
            stamp_ns = first_ns
        elif meaning.header == "end":
            stamp_ns = header_ns - span_ns
        elif meaning.header == "first":
            stamp_ns = header_ns
        else:
            stamp_ns = header_ns + first_ns
        if abs(stamp_ns) > _NEVER_NS:
            raise DataError("point_time", f"points of {first:g}, which is no time")
        return PointTimes(stamp_ns, stamp_ns + span_ns, t_ns, ~good)

    def _decide(self, header_ns: int, time: NDArray[Any]) -> TimeMeaning:
        values = time[time != 0]
        if len(values) < 2:
            raise DataError("point_time", "no point has a usable time")
        low, high = float(values.min()), float(values.max())
        unit, absolute = self._unit(low, high)
        header = "zero"
        if absolute and abs(_float_to_ns(low, _UNITS_NS[unit]) - header_ns) > _SAME_CLOCK_NS:
            self.notes.append("point times come from another clock than header.stamp: only their differences are used")
            absolute, header = False, "end" if self._stamp == "end" else "first"
        elif not absolute and self._stamp == "end" and float(time.min()) >= 0:
            header = "end"  # offsets count from the scan's start, the header from its end
        return TimeMeaning(_UNITS_NS[unit], absolute, header)

    def _unit(self, low: float, high: float) -> tuple[str, bool]:
        """The unit in which a scan lasts nearest to a scan period, and whether values count from the epoch."""
        for unit, unit_ns in _UNITS_NS.items():
            if low * unit_ns > 1e17:  # after 1973
                span_ns = (high - low) * unit_ns
                if span_ns < 10 * self._period_ns:
                    return unit, True
        span = max(high - low, 1e-12)
        unit = min(_UNITS_NS, key=lambda name: abs(np.log(span * _UNITS_NS[name] / self._period_ns)))
        if span * _UNITS_NS[unit] > 20 * self._period_ns or span * _UNITS_NS[unit] < self._period_ns / 1000:
            raise DataError("point_time", f"points of one scan differ by {span:g}, expected about one scan period")
        return unit, False


def _float_to_ns(value: float, unit_ns: int) -> int:
    """value x unit_ns with the whole part kept exact (a float64 product would round epochs to 256 ns)."""
    whole = int(value)
    return whole * unit_ns + round((value - whole) * unit_ns)


def times_from_azimuth(points_lidar: NDArray[np.float32], ring: NDArray[Any], period_ns: int) -> NDArray[np.int64]:
    """Per-point time when the driver gives none: the share of the turn since the first point, (N,) int64 ns.

    The sense of rotation is the one most neighbours of a ring have. Points a little before the first one in azimuth
    (rings fire at slightly different azimuths) belong to the start, not to the end of the turn: their place in the
    ring's own order decides.
    """
    finite = np.isfinite(points_lidar).all(axis=1) & (points_lidar[:, :2] != 0).any(axis=1)
    t_ns = np.zeros(len(points_lidar), dtype=np.int64)
    index = np.flatnonzero(finite)
    if len(index) < 2:
        return t_ns
    azimuth = np.arctan2(points_lidar[index, 1].astype(np.float64), points_lidar[index, 0].astype(np.float64))
    order = np.argsort(ring[index], kind="stable")
    ring_sorted, azimuth_sorted = ring[index][order], azimuth[order]
    same = ring_sorted[1:] == ring_sorted[:-1]
    step = (np.diff(azimuth_sorted) + np.pi) % (2 * np.pi) - np.pi
    sense = 1.0 if same.any() and np.median(step[same]) > 0 else -1.0
    turn = (sense * (azimuth - azimuth[0])) / (2 * np.pi) % 1.0
    # rings by their order, not by their numbers: those are the driver's, and may be anything
    ring_index = np.concatenate([[0], np.cumsum(~same)])
    counts = np.bincount(ring_index)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    place = np.empty(len(index))
    place[order] = (np.arange(len(index)) - starts[ring_index]) / counts[ring_index]
    turn -= np.rint(turn - place) * (np.abs(turn - place) > 0.5)
    turn -= turn.min()
    t_ns[index] = np.rint(np.clip(turn, 0.0, 1.0) * period_ns).astype(np.int64)
    return t_ns
