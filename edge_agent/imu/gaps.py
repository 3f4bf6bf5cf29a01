"""Where the IMU is silent: samples as they would be if the motion went on as it was.

A gap is longer than what interpolation may bridge. In it the body's velocity is held and its turning rate goes in a
line from what it was to what it is afterwards, or stays; the noise of such samples is what a robot may do meanwhile.
So everything that integrates goes on, and the answers of the map service carry the pose.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from statistics import median

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.scan import ImuSamples

Array = NDArray[np.float64]
_PERIODS = 5
_SHORTEST_NS = 50_000_000
_STEP_NS = 10_000_000
_KEPT = 51


class Gaps:
    """Knows the IMU's period and remembers where it was silent. count, seconds: of all gaps so far."""

    def __init__(self, rate_hz: float) -> None:
        self._periods_ns: deque[int] = deque([int(1e9 / rate_hz)], _KEPT)
        self._longest_ns = self._longest()
        self._unheard = 0  # periods since that was found
        self._last_ns: int | None = None
        self._intervals: list[tuple[int, int]] = []
        self._filled_ns = 0
        self.count, self.seconds = 0, 0.0

    def seen(self, stamps_ns: NDArray[np.int64]) -> None:
        """Takes the stamps (M,) of real samples."""
        stamps = stamps_ns.tolist()
        known = stamps if self._last_ns is None else [self._last_ns, *stamps]
        periods = [after - before for before, after in pairwise(known) if after > before]
        self._periods_ns.extend(periods)
        self._unheard += len(periods)
        self._last_ns = known[-1] if known else None

    def between(self, last_ns: int, next_ns: int) -> bool:
        """Is so long a time without samples a gap?"""
        if 4 * self._unheard >= len(self._periods_ns):  # a median hardly changes with fewer
            self._longest_ns, self._unheard = self._longest(), 0
        return next_ns - last_ns > self._longest_ns

    def _longest(self) -> int:
        return max(_SHORTEST_NS, _PERIODS * int(median(self._periods_ns)))

    def remember(self, start_ns: int, end_ns: int) -> None:
        """A gap was filled, or a further piece of one while the IMU is still silent."""
        self._intervals.append((start_ns, end_ns))
        self.count += start_ns > self._filled_ns
        self.seconds += (end_ns - start_ns) * 1e-9
        self._filled_ns = end_ns

    def overlap(self, start_ns: int, end_ns: int) -> bool:
        """Is any of [start, end] filled?"""
        return any(a < end_ns and start_ns < b for a, b in self._intervals)

    def drop_before(self, stamp_ns: int) -> None:
        """Forgets gaps that ended before."""
        self._intervals = [interval for interval in self._intervals if interval[1] >= stamp_ns]


def carried_on(
    start_ns: int, until_ns: int, gyro_radps: tuple[Array, Array], state: Array, bias: Array, gravity_mps2: float
) -> ImuSamples:
    """Samples every 10 ms in (start, until].

    gyro_radps: (3,) at the start and at the end, bias in it. state: row (15,) of the Imu node at the start. bias (6,),
    gyro first. The specific force is that of a body that keeps its own velocity while it turns: R^T g + w x v.
    """
    count = max(-(-(until_ns - start_ns) // _STEP_NS), 1)
    shares = np.arange(1, count + 1) / count
    stamps_ns = start_ns + ((until_ns - start_ns) * np.arange(1, count + 1) // count).astype(np.int64)
    gyro = (1 - shares)[:, None] * gyro_radps[0] + shares[:, None] * gyro_radps[1]
    R, dt = state[:9].reshape(3, 3), (until_ns - start_ns) * 1e-9 / count
    velocity_imu = R.T @ state[12:]
    accel = np.empty((count, 3))
    for k, rate in enumerate(gyro - bias[:3]):
        R = R @ se3.so3_exp(rate * dt)
        accel[k] = R.T @ np.array([0.0, 0.0, gravity_mps2]) + np.cross(rate, velocity_imu) + bias[3:]
    return ImuSamples(stamps_ns, gyro, accel)
