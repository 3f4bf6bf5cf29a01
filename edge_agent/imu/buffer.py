"""The recent IMU samples, and what they say about the IMU's real noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import _kernels as kernels
from splitslam.scan import ImuSamples

_ROOM = 1024
_NOISE_SAMPLES = 500
_LONGEST_BLOCK_S = 0.05
_LAST_SAMPLES = 10
_UNKNOWN_GYRO_RADPS = 0.01
_UNKNOWN_ACCEL_MPS2 = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class ImuWindow:
    """Samples over [start, end], both ends included: interpolated, or held beyond the first and last sample."""

    stamps_ns: NDArray[np.int64]
    gyro_radps: NDArray[np.float64]
    accel_mps2: NDArray[np.float64]


class ImuBuffer:
    """Keeps samples from `drop_before` on; time only goes forward. What it hands out of itself is overwritten later."""

    def __init__(self) -> None:
        self._stamps, self._values = np.empty(_ROOM, np.int64), np.empty((_ROOM, 6))
        self._first = self._end = 0
        self._recent = np.empty((4 * _NOISE_SAMPLES, 6))
        self._recent_end = 0
        self._noise: tuple[float, float] | None = None
        self._noise_for = 0  # samples since then

    def __len__(self) -> int:
        return self._end - self._first

    @property
    def last_gyro_radps(self) -> NDArray[np.float64]:
        """(3,) mean of the newest samples: one of them is noise and the shake of a step."""
        return self._values[max(self._first, self._end - _LAST_SAMPLES) : self._end, :3].mean(axis=0)

    @property
    def last_ns(self) -> int:
        """Stamp of the newest sample."""
        return int(self._stamps[self._end - 1])

    def append(self, samples: ImuSamples, made: bool = False) -> None:
        """Adds samples, all newer than the last; made ones (gaps.py) say nothing about the IMU's noise."""
        n = len(samples)
        if self._end + n > len(self._stamps):
            self._make_room(n)
        rows = slice(self._end, self._end + n)
        self._stamps[rows] = samples.stamps_ns
        self._values[rows, :3], self._values[rows, 3:] = samples.gyro_radps, samples.accel_mps2
        self._end += n
        if not made:
            self._remember(self._values[rows][-_NOISE_SAMPLES:])

    def _make_room(self, n: int) -> None:
        kept = len(self)
        stamps, values = self._stamps, self._values
        if 2 * (kept + n) > len(stamps):
            stamps, values = np.empty(4 * (kept + n), np.int64), np.empty((4 * (kept + n), 6))
        stamps[:kept], values[:kept] = self._stamps[self._first : self._end], self._values[self._first : self._end]
        self._stamps, self._values, self._first, self._end = stamps, values, 0, kept

    def _remember(self, values: NDArray[np.float64]) -> None:
        n = len(values)
        if self._recent_end + n > len(self._recent):
            self._recent[:_NOISE_SAMPLES] = self._recent[self._recent_end - _NOISE_SAMPLES : self._recent_end]
            self._recent_end = _NOISE_SAMPLES
        self._recent[self._recent_end : self._recent_end + n] = values
        self._recent_end += n
        self._noise_for += n

    def drop_before(self, stamp_ns: int) -> None:
        """Forgets what lies before the last sample at or before `stamp_ns`."""
        stamps = self._stamps[self._first : self._end]
        self._first += max(int(stamps.searchsorted(stamp_ns, side="right")) - 1, 0)

    def window(self, start_ns: int, end_ns: int, *also_ns: int) -> ImuWindow:
        """All samples strictly inside (start, end), and interpolated ones at both ends and at also_ns, rising."""
        own_ns, values = self._stamps[self._first : self._end], self._values[self._first : self._end]
        first = int(own_ns.searchsorted(start_ns, side="right"))
        last = max(int(own_ns.searchsorted(end_ns, side="left")), first)
        marks_ns = np.array([start_ns, *also_ns, end_ns])
        most = last - first + len(marks_ns)
        stamps, gyro, accel = np.empty(most, np.int64), np.empty((most, 3)), np.empty((most, 3))
        n = kernels.window(own_ns, values, first, marks_ns, stamps, gyro, accel)
        return ImuWindow(stamps[:n], gyro[:n], accel[:n])

    def noise_densities(self) -> tuple[float, float]:
        """(gyro rad/s/sqrt(Hz), accel m/s^2/sqrt(Hz)) seen in the samples themselves; cautious while unknown.

        The deviation of a block's mean from its neighbours' mean holds white noise and all motion that the blocks do
        not resolve (variance 1.5 sigma^2). With a slow IMU that is far more than the data sheet's figure. Vibration
        averages out over longer blocks while white noise goes on as before: the quietest block length counts. Looked at
        again after every tenth of the samples that it is found from.
        """
        if len(self) < 2:
            return _UNKNOWN_GYRO_RADPS, _UNKNOWN_ACCEL_MPS2
        if self._noise is None or 10 * self._noise_for >= min(self._recent_end, _NOISE_SAMPLES):
            self._noise, self._noise_for = self._look(), 0
        return self._noise

    def _look(self) -> tuple[float, float]:
        period_s = (self.last_ns - int(self._stamps[self._first])) * 1e-9 / (len(self) - 1)
        recent = self._recent[max(0, self._recent_end - _NOISE_SAMPLES) : self._recent_end]
        if len(recent) < 12:
            return _UNKNOWN_GYRO_RADPS * period_s**0.5, _UNKNOWN_ACCEL_MPS2 * period_s**0.5
        densities = np.empty(2)
        kernels.quietest(recent, period_s, _LONGEST_BLOCK_S, densities)
        return float(densities[0]), float(densities[1])
