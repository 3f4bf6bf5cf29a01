"""The rest before the first motion: what the accelerometer says then is gravity and its own bias (INS: alignment).

Whether a robot stands, an IMU cannot tell; that it is not accelerated, it can: nothing changes. A robot that starts in
steady motion may be taken for one at rest, therefore nothing is said of its velocity.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu.buffer import ImuWindow

Array = NDArray[np.float64]
_LEAST_MEANS = 5  # before anything is said: half a second
_LATE_MEANS = 3  # a motion has begun before it shows
_KEPT_MEANS = 50  # a bias may wander in a long rest
_SIGMAS = 6.0
_MOST_MPS2, _MOST_RADPS = 0.1, 0.01  # change of a mean in rest: a hand's
_TURNING_RADPS = 0.02  # more than a gyroscope's bias: in a steady curve nothing changes either, but v * w is no gravity
_SHAKEN_MPS2 = 0.5  # standard deviation of samples
_LEAST_MPS2, _LEAST_RADPS = 5e-3, 1e-4  # scatter of means, where samples are coarse
_INEXACT_MPS2 = 0.1  # of a mean: 10 mrad; what a bias may be, engines shake, hands sway


@dataclass(frozen=True, slots=True, eq=False)
class AtRest:
    """The mean specific force (3,) between two scans, frame `imu`, of an IMU in rest, and its deviation an axis."""

    accel_mps2: Array
    sigma_mps2: float


@dataclass
class Rest:
    """Watches the times between scans, from the first on; `over` for good once something has changed."""

    over: bool = False
    _gyro: deque[Array] = field(default_factory=lambda: deque(maxlen=_KEPT_MEANS))
    _accel: deque[Array] = field(default_factory=lambda: deque(maxlen=_KEPT_MEANS))

    def seen(self, window: ImuWindow) -> AtRest | None:
        """Takes the IMU between the last two scans; gives what it was a little before, None before and after rest."""
        if self.over:
            return None
        gyro, accel = window.gyro_radps.mean(axis=0), window.accel_mps2.mean(axis=0)
        gyro_sigma = max(_scatter(self._gyro), _LEAST_RADPS)
        accel_sigma = max(_scatter(self._accel), _LEAST_MPS2)
        if self._gyro:
            turned, moved = _change(gyro, self._gyro), _change(accel, self._accel)
            self.over = turned > _MOST_RADPS or moved > _MOST_MPS2
            if len(self._gyro) >= _LEAST_MEANS:
                self.over |= turned > _SIGMAS * gyro_sigma or moved > _SIGMAS * accel_sigma
        self.over |= bool(np.linalg.norm(gyro) > _TURNING_RADPS)
        self.over |= bool(np.linalg.norm(window.accel_mps2.std(axis=0)) > _SHAKEN_MPS2)
        self._gyro.append(gyro)
        self._accel.append(accel)
        if self.over or len(self._gyro) <= _LEAST_MEANS:
            return None
        return AtRest(self._accel[-1 - _LATE_MEANS], float(np.hypot(accel_sigma, _INEXACT_MPS2)))


def _change(mean: Array, before: Collection[Array]) -> float:
    return float(np.abs(mean - np.mean([*before], axis=0)).max())


def _scatter(means: Collection[Array]) -> float:
    """Standard deviation of one axis."""
    return float(np.sqrt(np.var([*means], axis=0, ddof=1).mean())) if len(means) > 1 else 0.0
