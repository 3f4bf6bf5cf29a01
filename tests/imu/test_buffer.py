"""What the samples themselves say of the IMU's noise."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.imu.buffer import ImuBuffer
from splitslam.scan import ImuSamples


def filled(rate_hz: float, accel: np.ndarray) -> ImuBuffer:
    buffer = ImuBuffer()
    stamps = (np.arange(len(accel)) * 1e9 / rate_hz).astype(np.int64)
    for part in np.array_split(np.arange(len(accel)), 20):
        buffer.append(ImuSamples(stamps[part], np.zeros((len(part), 3)), accel[part]))
    return buffer


@pytest.mark.parametrize("rate_hz", [50.0, 200.0, 500.0])
def test_white_noise_is_measured_at_its_density(rate_hz):
    density = 0.01
    accel = np.random.default_rng(1).normal(0, density * np.sqrt(rate_hz), (500, 3))
    assert filled(rate_hz, accel).noise_densities()[1] == pytest.approx(density, rel=0.15)


def test_vibration_is_not_taken_for_white_noise():
    # 3 m/s^2 at 37 Hz, sampled at 100 Hz: as white noise of the samples' scatter it would move a robot by metres
    t = np.arange(600) / 100.0
    accel = 3.0 * np.sin(2 * np.pi * 37.0 * t)[:, None] * np.ones(3)
    by_samples = 3.0 / np.sqrt(2) / np.sqrt(100.0)
    assert filled(100.0, accel).noise_densities()[1] < 0.6 * by_samples


def test_motion_that_a_slow_imu_does_not_resolve_counts_as_noise():
    t = np.arange(60) / 10.0
    accel = np.sin(2 * np.pi * 2.0 * t)[:, None] * np.ones(3)
    assert filled(10.0, accel).noise_densities()[1] > 0.1
