"""Rotations by the thousand and the integrated IMU, held to their naive twins."""

from __future__ import annotations

import itertools

import numpy as np

from splitslam import se3
from splitslam.check.imu_track import ImuTrack, bend
from splitslam.check.rotations import exps, increments, logs
from splitslam.scan import ImuSamples
from tests import tolerances
from tests.check import made


def test_exponential_and_logarithm_are_those_of_a_single_rotation() -> None:
    rng = np.random.default_rng(3)
    vectors = np.concatenate([rng.normal(size=(50, 3)) * 0.8, rng.normal(size=(50, 3)) * 1e-9, np.zeros((1, 3))])
    R = exps(vectors)
    for vector, rotation in zip(vectors, R, strict=True):
        np.testing.assert_allclose(rotation, se3.so3_exp(vector), atol=tolerances.SE3_ROUND_TRIP_RAD)
    np.testing.assert_allclose(logs(R), vectors, atol=tolerances.SE3_ROUND_TRIP_RAD)
    naive = [se3.so3_log(a.T @ b) for a, b in itertools.pairwise(R)]
    np.testing.assert_allclose(increments(R), naive, atol=tolerances.SE3_ROUND_TRIP_RAD)


def _track(rate_hz: float) -> tuple[ImuTrack, ImuSamples]:
    samples = made.samples(made.WALK, 4.0, rate_hz=rate_hz, noise=0.0)
    return ImuTrack(samples, made.START_NS, np.array([0.003, -0.002, 0.004])), samples


def test_an_imu_gives_the_true_rotation_between_any_times() -> None:
    t = np.array([0.013, 0.1, 0.77, 2.2501, 3.9])
    R = made.T_LIDAR_IMU[:3, :3]
    true = made.WALK.attitude(t) @ R
    for rate_hz, bar_rad in ((200.0, tolerances.CHECK_INTEGRATED_RAD), (10.0, tolerances.CHECK_INTEGRATED_10HZ_RAD)):
        found = _track(rate_hz)[0].rotations(t)
        assert np.abs(increments(found) - increments(true)).max() < bar_rad


def test_the_weighted_force_is_the_integral_that_its_name_says() -> None:
    track, samples = _track(200.0)
    t, lag = np.arange(0.1, 3.0, 0.13), 3
    force, by_force = track.force(t, lag)
    fine = np.linspace(t[0], t[2 * lag], 20_001)
    weight = np.interp(fine, [t[0], t[lag], t[2 * lag]], [0.0, 1.0, 0.0])
    imu_s = (samples.stamps_ns - made.START_NS) * 1e-9
    felt = np.stack([np.interp(fine, imu_s, samples.accel_mps2[:, c]) for c in range(3)], axis=1)
    R = track.rotations(t[lag : lag + 1])[0].T @ track.rotations(fine)
    naive = np.trapezoid(weight[:, None] * np.einsum("nij,nj->ni", R, felt), fine, axis=0)
    np.testing.assert_allclose(force[0], naive, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(by_force[0], np.trapezoid(weight[:, None, None] * R, fine, axis=0), atol=1e-5)


def test_bend_is_the_change_of_the_mean_velocity() -> None:
    t = np.array([0.0, 0.1, 0.3, 0.4, 0.7])
    values = 3.0 * t[:, None] ** 2
    for k, bent in enumerate(bend(t, values, 1)[:, 0]):
        before = (values[k + 1] - values[k]) / (t[k + 1] - t[k])
        after = (values[k + 2] - values[k + 1]) / (t[k + 2] - t[k + 1])
        np.testing.assert_allclose(bent, after - before)
