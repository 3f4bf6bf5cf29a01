"""Kernels of the motion and of version 1 against naive twins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitslam import se3
from splitslam._motion_kernels import vector_of
from splitslam.codec import (
    _motion_kernels,
    _version1_kernels,
)
from splitslam.features import Motion
from tests.codec.frames import motion


def measured(m: Motion) -> tuple[bool, np.ndarray, np.ndarray]:
    fields, steps = np.zeros(5, np.int64), np.zeros(16, np.int64)
    parts = m.T_prev_lidar, m.covariance, m.velocity_lidar_mps, m.gravity_lidar, m.gravity_sigma_rad
    return _motion_kernels.measure(*parts, fields, steps), fields, steps


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_motion_in_steps_is_the_motion(axis: int, sign: int):
    down = np.insert([0.36, -0.48], axis, sign * 0.8)
    m = replace(motion(), gravity_lidar=3.0 * down)  # any length
    known, fields, steps = measured(m)
    assert known
    np.testing.assert_array_equal(steps[:3], np.rint(se3.so3_log(m.T_prev_lidar[:3, :3]) / 1e-5))
    np.testing.assert_array_equal(steps[3:6], np.rint(m.T_prev_lidar[:3, 3] / 1e-4))
    np.testing.assert_array_equal(steps[6:9], np.rint(m.velocity_lidar_mps / 1e-3))
    sigmas = np.append(np.sqrt(np.diag(m.covariance)), m.gravity_sigma_rad)
    np.testing.assert_array_equal(steps[9:], np.rint(8 * np.log2(sigmas / 1e-6)))
    T, covariance, velocity_mps, got_down = np.eye(4), np.zeros((6, 6)), np.empty(3), np.empty(3)
    sigma_rad = _motion_kernels.place(fields, steps, T, covariance, velocity_mps, got_down)
    np.testing.assert_allclose(T, m.T_prev_lidar, atol=1e-4)
    np.testing.assert_allclose(np.diag(covariance), np.diag(m.covariance), rtol=0.1)
    np.testing.assert_allclose(velocity_mps, m.velocity_lidar_mps, atol=5.1e-4)
    np.testing.assert_allclose(got_down, down, atol=1e-4)
    assert sigma_rad == pytest.approx(m.gravity_sigma_rad, rel=0.05)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-3, 1.0, 2.0, 3.1, np.pi - 1e-7, np.pi])
def test_a_rotation_of_any_angle_becomes_its_vector(angle_rad: float):
    for axis in np.vstack([np.eye(3), np.random.default_rng(0).normal(size=(6, 3))]):
        R, w = se3.so3_exp(angle_rad * axis / np.linalg.norm(axis)), np.empty(3)
        vector_of(R, w)
        np.testing.assert_allclose(np.linalg.norm(w), angle_rad, atol=1e-9)
        np.testing.assert_allclose(se3.so3_exp(w), R, atol=1e-9)


def test_motion_that_is_not_finite_or_beyond_all_bounds_is_reported():
    T, zero, nothing = np.eye(4), np.zeros(3), np.full(3, np.nan)
    T[0, 3] = 1e9
    for bad in (
        {"T_prev_lidar": T},
        {"velocity_lidar_mps": nothing},
        {"gravity_lidar": zero},
        {"gravity_lidar": nothing},
        {"covariance": np.full((6, 6), np.nan)},
        {"gravity_sigma_rad": float("nan")},
    ):
        assert not measured(replace(motion(), **bad))[0], bad
    _, fields, steps = measured(motion())
    for where, index, value in ((fields, 1, 3), (fields, 3, 0), (steps, 4, 1 << 29)):
        kept, where[index] = int(where[index]), value
        rest = np.eye(4), np.zeros((6, 6)), np.empty(3), np.empty(3)
        assert _motion_kernels.place(fields, steps, *rest) == -1.0
        where[index] = kept


def test_what_the_last_knot_says_is_taken_off_and_put_back():
    steps = np.arange(16, dtype=np.int64) * 7
    rotation, translation_m = np.array([0.01, -0.02, 0.3]), np.array([0.5, -0.1, 0.0])
    differences = steps.copy()
    _motion_kernels.expect(differences, rotation, translation_m, 100_000, False)
    want = steps - np.concatenate([rotation / 1e-5, translation_m / 1e-4, translation_m / 1e-4, np.zeros(7)])
    want[10:] = 7
    np.testing.assert_array_equal(differences, np.rint(want))
    _motion_kernels.expect(differences, rotation, translation_m, 100_000, True)
    np.testing.assert_array_equal(differences, steps)


@pytest.mark.parametrize("signed", [True, False])
def test_symbols_and_bits_of_version_1_join_to_values(signed: bool):
    rng = np.random.default_rng(1)
    values = (rng.integers(0, 2**29, 300) >> rng.integers(0, 29, 300)).astype(np.int64)
    values[:5] = [0, 1, 63, 64, 2**29 - 1]
    values = np.where(rng.random(300) < 0.5, -values, values) if signed else values
    symbols, bits = np.empty(300, np.uint8), []
    for i, value in enumerate(values.tolist()):
        u = (-2 * value - 1 if value < 0 else 2 * value) if signed else value
        e = u.bit_length() - 1
        symbols[i] = u if u < 64 else 64 + (e - 6) * 8 + ((u >> (e - 3)) & 7)
        bits += [(u >> k) & 1 for k in range(e - 3)] if u >= 64 else []
    packed = np.packbits(np.array(bits, np.uint8), bitorder="little")
    back = np.empty(300, np.int32)
    assert _version1_kernels.join(symbols, signed, packed, 0, back) == len(bits)
    np.testing.assert_array_equal(back, values)
    assert _version1_kernels.join(symbols, signed, packed[: len(packed) // 2], 0, back) == -1


def test_predictions_of_version_1_are_integers_that_follow_the_residual():
    fraction = 0
    for _ in range(40):
        fraction = _version1_kernels.blend(fraction, 1000, 5)
    assert abs(_version1_kernels.predict(fraction, 2000) - 10) <= 1
    assert _version1_kernels.blend(fraction, 0, 5) == fraction
    assert abs(_version1_kernels.blend(0, 1, 10**6)) <= 1 << 18
