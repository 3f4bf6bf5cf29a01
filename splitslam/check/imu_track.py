"""An IMU's samples integrated once, so that rotation and tent-weighted force between any times are a look-up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.check.rotations import exps
from splitslam.scan import ImuSamples

Array = NDArray[np.float64]
_LONGEST_STEP_S = 0.01


class ImuTrack:
    """Attitude and double integral of the specific force, in the IMU's own frame at its first sample.

    Between samples rate and force are linear (trapezoidal rule); steps longer than 10 ms are cut, so that a 10 Hz IMU
    is integrated as well as its samples allow. Times are seconds after `origin_ns`.
    """

    def __init__(self, samples: ImuSamples, origin_ns: int, gyro_bias_radps: Array) -> None:
        t_s: Array = np.multiply(samples.stamps_ns - origin_ns, 1e-9, dtype=np.float64)
        t_s, gyro, force = _subdivided(t_s, samples.gyro_radps - gyro_bias_radps, samples.accel_mps2)
        step = np.diff(t_s)[:, None]
        turns = exps(0.5 * (gyro[1:] + gyro[:-1]) * step)
        R = np.empty((len(t_s), 3, 3))
        R[0] = np.eye(3)
        for k, turn in enumerate(turns):
            np.matmul(R[k], turn, out=R[k + 1])
        self._t_s, self._gyro, self._R = t_s, gyro, R
        self._first = np.concatenate([(R @ force[:, :, None])[:, :, 0], R.reshape(-1, 9)], axis=1)  # to be integrated
        trapezoid = 0.5 * (self._first[1:] + self._first[:-1]) * step
        self._once = np.concatenate([np.zeros((1, 12)), np.cumsum(trapezoid, axis=0)])
        twice = (self._once[:-1] + (2.0 * self._first[:-1] + self._first[1:]) * step / 6.0) * step
        self._twice = np.concatenate([np.zeros((1, 12)), np.cumsum(twice, axis=0)])

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the first and the last sample."""
        return float(self._t_s[0]), float(self._t_s[-1])

    def rotations(self, t_s: Array) -> Array:
        """R_first_imu(t), (N, 3, 3)."""
        i, h = self._place(t_s)
        share = (h / np.diff(self._t_s)[i])[:, None]
        rate = self._gyro[i] + 0.5 * share * (self._gyro[i + 1] - self._gyro[i])
        return self._R[i] @ exps(rate * h[:, None])

    def force(self, t_s: Array, lag: int) -> tuple[Array, Array]:
        """Integral of the specific force weighted by a tent over t[k], t[k + lag], t[k + 2 lag], for each k.

        (N - 2 lag, 3) in m/s, in the IMU's frame at the middle time, and its derivative by the force (.., 3, 3). The
        tent's integral of an acceleration is the change of the mean velocity from the first half to the second.
        """
        i, h = self._place(t_s)
        h = h[:, None]
        twice = self._twice[i] + self._once[i] * h + 0.5 * self._first[i] * h**2
        tent = bend(t_s, twice, lag)
        back = self.rotations(t_s[lag:-lag]).transpose(0, 2, 1)
        return (back @ tent[:, :3, None])[:, :, 0], back @ tent[:, 3:].reshape(-1, 3, 3)

    def _place(self, t_s: Array) -> tuple[NDArray[np.intp], Array]:
        i = np.clip(np.searchsorted(self._t_s, t_s, side="right") - 1, 0, len(self._t_s) - 2)
        return i, t_s - self._t_s[i]


def bend(t_s: Array, values: Array, lag: int) -> Array:
    """Slope after minus slope before, at each middle of (t[k], t[k + lag], t[k + 2 lag]): (N, D) -> (N - 2 lag, D)."""
    slope = (values[lag:] - values[:-lag]) / (t_s[lag:] - t_s[:-lag])[:, None]
    return slope[lag:] - slope[:-lag]


def _subdivided(t_s: Array, gyro: Array, force: Array) -> tuple[Array, Array, Array]:
    step = np.diff(t_s)
    parts = np.maximum(np.ceil(step / _LONGEST_STEP_S).astype(np.int64), 1)
    if parts.max(initial=1) == 1:
        return t_s, gyro, force
    first = np.repeat(np.arange(len(step)), parts)
    share = (np.arange(len(first)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[first]

    def cut(values: Array) -> Array:
        s = share if values.ndim == 1 else share[:, None]
        return np.concatenate([values[first] + s * (values[first + 1] - values[first]), values[-1:]])

    return cut(t_s), cut(gyro), cut(force)
