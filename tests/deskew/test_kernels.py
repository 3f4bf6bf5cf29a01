"""Kernels against naive twins; also run with NUMBA_DISABLE_JIT=1 (tests/codec/test_without_jit.py)."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.deskew._kernels import deskew_points
from splitslam import _motion_kernels as kernels
from splitslam import se3
from splitslam.motion_table import motion_table
from tests.deskew.motions import FAST_TURN_RADPS, far_points, imu_offsets, turning


def test_rotation_kernels_are_exp_and_log():
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-8, 1e-5, 1e-3, 0.1, 1.5):
        w = rng.normal(size=3)
        w *= size / np.linalg.norm(w)
        base = se3.so3_exp(rng.normal(size=3))
        R, back = np.empty((3, 3)), np.empty(3)
        kernels.rotation_from_vector(w[0], w[1], w[2], R)
        np.testing.assert_allclose(R, se3.so3_exp(w), atol=1e-12)
        kernels.vector_between(base, base @ R, back)
        np.testing.assert_allclose(back, w, atol=1e-12)


def test_the_motion_table_holds_the_interpolated_poses_at_its_breaks():
    knots = turning(imu_offsets(200), FAST_TURN_RADPS)
    table = motion_table(knots)
    assert np.all(np.diff(table.breaks_ns) > 0)
    assert np.diff(table.breaks_ns).max() <= 400_000
    assert set(knots.offsets_ns) <= set(table.breaks_ns)
    for s in range(0, len(table.base), 7):
        t = table.breaks_ns[s]
        k = min(int(np.searchsorted(knots.offsets_ns, t, side="right")) - 1, len(knots.offsets_ns) - 2)
        a, b = (se3.compose(se3.so3_exp(knots.rotation[j]), knots.translation_m[j]) for j in (k, k + 1))
        span = knots.offsets_ns[k + 1] - knots.offsets_ns[k]
        T = se3.interpolate(a, b, (t - knots.offsets_ns[k]) / span)
        np.testing.assert_allclose(table.base[s], T[:3].reshape(-1), atol=1e-6)


def test_a_long_gap_between_knots_does_not_make_a_huge_table():
    knots = turning(np.array([0, 60_000_000_000]), 0.001)
    assert len(motion_table(knots).base) <= 4096


@pytest.mark.parametrize("seed", range(3))
def test_deskew_points_is_the_affine_map_of_the_points_segment(seed: int):
    table = motion_table(turning(imu_offsets(100), FAST_TURN_RADPS))
    points, t = far_points(60, 80.0, seed)
    t[0], t[1] = 0, 100_000_000
    out = np.empty_like(points)
    deskew_points(points, t, table.breaks_ns, table.base, table.slope, out)
    for p, ti, o in zip(points, t, out, strict=True):
        s = max(k for k in range(len(table.base)) if table.breaks_ns[k] <= ti)
        M = (table.base[s] + table.slope[s] * float(ti - table.breaks_ns[s])).reshape(3, 4).astype(np.float64)
        np.testing.assert_allclose(o, M[:, :3] @ p + M[:, 3], atol=1e-4)


def test_resampled_knots_are_slerp_between_the_old_ones():
    knots = turning(imu_offsets(50), FAST_TURN_RADPS)
    times = np.array([-5, 0, 1_000_000, 33_333_333, 99_999_999, 100_000_000, 200_000_000], np.int64)
    rotation, translation = np.empty((7, 3)), np.empty((7, 3))
    kernels.resample(knots.offsets_ns, knots.rotation, knots.translation_m, times, rotation, translation)
    for i, t in enumerate(np.clip(times, 0, 100_000_000)):
        k = min(int(np.searchsorted(knots.offsets_ns, t, side="right")) - 1, len(knots.offsets_ns) - 2)
        a, b = (se3.compose(se3.so3_exp(knots.rotation[j]), knots.translation_m[j]) for j in (k, k + 1))
        T = se3.interpolate(a, b, (t - knots.offsets_ns[k]) / (knots.offsets_ns[k + 1] - knots.offsets_ns[k]))
        np.testing.assert_allclose(rotation[i], se3.so3_log(T[:3, :3]), atol=1e-9)
        np.testing.assert_allclose(translation[i], T[:3, 3], atol=1e-12)
