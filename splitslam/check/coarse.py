"""A first look at gyro and LiDAR together: which delay makes their rotation speeds alike, and in which unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.check.motion import LidarMotion
from splitslam.scan import ImuSamples

Array = NDArray[np.float64]

SEARCH_S = 0.5
_STEP_S = 0.005
_ENOUGH_HZ = 200.0


@dataclass(frozen=True, slots=True)
class CoarseMatch:
    """delay_s: IMU stamps say later than it was. correlation: of the rotation speeds then, -1 to 1.

    scale: LiDAR's rotation speed over the gyro's. excitation_radps: standard deviation of the LiDAR's rotation speed.
    """

    delay_s: float
    correlation: float
    scale: float
    excitation_radps: float


def match(motion: LidarMotion, samples: ImuSamples) -> CoarseMatch | None:
    """Correlates rotation speeds from pose to pose over delays of up to half a second; None without common time."""
    t_s = (motion.stamps_ns - samples.stamps_ns[0]) * 1e-9
    imu_s = (samples.stamps_ns - samples.stamps_ns[0]) * 1e-9
    inside = (t_s > SEARCH_S) & (t_s < imu_s[-1] - SEARCH_S)
    pairs = inside[1:] & inside[:-1]
    if np.count_nonzero(pairs) < 20:
        return None
    speed = motion.rates_radps()[pairs]
    trapezoid = 0.5 * (samples.gyro_radps[1:] + samples.gyro_radps[:-1]) * np.diff(imu_s)[:, None]
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(trapezoid, axis=0)])
    dt_s = np.diff(t_s)[:, None]

    def gyro_speed(delay_s: float) -> Array:
        turned = np.stack([np.interp(t_s + delay_s, imu_s, angle[:, c]) for c in range(3)], axis=1)
        return np.linalg.norm(np.diff(turned, axis=0) / dt_s, axis=1)[pairs]

    delays = np.arange(-SEARCH_S, SEARCH_S + 0.5 * _STEP_S, _STEP_S)
    correlations = np.array([_correlation(speed, gyro_speed(delay)) for delay in delays])
    best = int(np.argmax(correlations))
    gyro = gyro_speed(float(delays[best]))
    fast = speed >= np.quantile(speed, 0.75)
    scale = float(np.median(speed[fast]) / max(float(np.median(gyro[fast])), 1e-9))
    return CoarseMatch(float(delays[best]), float(correlations[best]), scale, float(speed.std()))


def thinned(samples: ImuSamples) -> ImuSamples:
    """Means of neighbouring samples, so that about 200 a second are left; slower IMUs as they are."""
    span_s = (samples.stamps_ns[-1] - samples.stamps_ns[0]) * 1e-9
    block = max(1, int((len(samples) - 1) / max(span_s, 1e-9) / _ENOUGH_HZ + 0.25))
    n = len(samples) // block
    if block == 1 or n < 2:
        return samples

    def mean(values: NDArray) -> NDArray:
        return values[: n * block].reshape(n, block, -1).mean(axis=1)

    origin_ns = int(samples.stamps_ns[0])
    stamps_ns = origin_ns + np.rint(mean(samples.stamps_ns - origin_ns)[:, 0]).astype(np.int64)
    return ImuSamples(stamps_ns, mean(samples.gyro_radps), mean(samples.accel_mps2))


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-12))
