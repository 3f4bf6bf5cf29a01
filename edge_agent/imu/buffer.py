"""The recent IMU samples, and what they say about the IMU's real noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.scan import ImuSamples

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

    def at(self, stamps_ns: NDArray[np.int64]) -> ImuWindow:
        """The same window at other stamps (within it), linearly interpolated."""
        own = (self.stamps_ns - self.stamps_ns[0]).astype(np.float64)
        new = (stamps_ns - self.stamps_ns[0]).astype(np.float64)
        gyro = np.stack([np.interp(new, own, self.gyro_radps[:, c]) for c in range(3)], axis=1)
        accel = np.stack([np.interp(new, own, self.accel_mps2[:, c]) for c in range(3)], axis=1)
        return ImuWindow(stamps_ns, gyro, accel)

    def subdivided(self, max_step_ns: int) -> ImuWindow:
        """With points added so that no step is longer than `max_step_ns`."""
        steps = np.diff(self.stamps_ns)
        if not len(steps) or steps.max() <= max_step_ns:
            return self
        parts = [
            np.linspace(a, b, int(-(-(b - a) // max_step_ns)), endpoint=False).astype(np.int64)
            for a, b in zip(self.stamps_ns[:-1], self.stamps_ns[1:], strict=True)
        ]
        return self.at(np.concatenate([*parts, self.stamps_ns[-1:]]))


class ImuBuffer:
    """Keeps samples from `drop_before` on; time only goes forward."""

    def __init__(self) -> None:
        self._stamps = np.empty(0, np.int64)
        self._values = np.empty((0, 6))
        self._recent = np.empty((0, 6))

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def last_gyro_radps(self) -> NDArray[np.float64]:
        """(3,) mean of the newest samples: one of them is noise and the shake of a step."""
        return self._values[-_LAST_SAMPLES:, :3].mean(axis=0)

    @property
    def last_ns(self) -> int:
        """Stamp of the newest sample."""
        return int(self._stamps[-1])

    def append(self, samples: ImuSamples, made: bool = False) -> None:
        """Adds samples, all newer than the last; made ones (gaps.py) say nothing about the IMU's noise."""
        values = np.hstack([samples.gyro_radps, samples.accel_mps2])
        self._stamps = np.concatenate([self._stamps, samples.stamps_ns])
        self._values = np.concatenate([self._values, values])
        if not made:
            self._recent = np.concatenate([self._recent, values])[-_NOISE_SAMPLES:]

    def drop_before(self, stamp_ns: int) -> None:
        """Forgets what lies before the last sample at or before `stamp_ns`."""
        keep = max(int(np.searchsorted(self._stamps, stamp_ns, side="right")) - 1, 0)
        self._stamps, self._values = self._stamps[keep:], self._values[keep:]

    def window(self, start_ns: int, end_ns: int) -> ImuWindow:
        """All samples strictly inside (start, end) with interpolated ends."""
        first = int(np.searchsorted(self._stamps, start_ns, side="right"))
        last = int(np.searchsorted(self._stamps, end_ns, side="left"))
        stamps = np.concatenate([[start_ns], self._stamps[first:last], [end_ns]]).astype(np.int64)
        ends = np.stack([self._at(start_ns), self._at(end_ns)])
        values = np.concatenate([ends[:1], self._values[first:last], ends[1:]])
        return ImuWindow(stamps, np.ascontiguousarray(values[:, :3]), np.ascontiguousarray(values[:, 3:]))

    def _at(self, stamp_ns: int) -> NDArray[np.float64]:
        i = int(np.searchsorted(self._stamps, stamp_ns))
        if i == 0 or i == len(self._stamps):
            return self._values[min(i, len(self._stamps) - 1)]
        a, b = self._stamps[i - 1], self._stamps[i]
        ratio = (stamp_ns - a) / (b - a)
        return (1 - ratio) * self._values[i - 1] + ratio * self._values[i]

    def noise_densities(self) -> tuple[float, float]:
        """(gyro rad/s/sqrt(Hz), accel m/s^2/sqrt(Hz)) seen in the samples themselves; cautious while unknown.

        The deviation of a block's mean from its neighbours' mean holds white noise and all motion that the blocks do
        not resolve (variance 1.5 sigma^2). With a slow IMU that is far more than the data sheet's figure. Vibration
        averages out over longer blocks while white noise goes on as before: the quietest block length counts.
        """
        if len(self._stamps) < 2:
            return _UNKNOWN_GYRO_RADPS, _UNKNOWN_ACCEL_MPS2
        period_s = (self._stamps[-1] - self._stamps[0]) * 1e-9 / (len(self._stamps) - 1)
        if len(self._recent) < 12:
            return _UNKNOWN_GYRO_RADPS * period_s**0.5, _UNKNOWN_ACCEL_MPS2 * period_s**0.5
        quietest = np.full(2, np.inf)
        count = 1
        while count == 1 or (count * period_s <= _LONGEST_BLOCK_S and len(self._recent) >= 12 * count):
            whole = len(self._recent) // count * count
            means = self._recent[-whole:].reshape(-1, count, 6).mean(axis=1)
            rough = means[1:-1] - 0.5 * (means[:-2] + means[2:])
            variance = np.mean(rough**2, axis=0) / 1.5 * period_s * count
            quietest = np.minimum(quietest, [variance[:3].mean(), variance[3:].mean()])
            count *= 2
        return float(np.sqrt(quietest[0])), float(np.sqrt(quietest[1]))
