"""Kernels against naive twins; also run with NUMBA_DISABLE_JIT=1 (tests/test_kernels_without_the_jit.py)."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.deskew._kernels import deskew_points
from edge_agent.deskew.fixed_table import fixed_table
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
def test_deskew_points_is_the_affine_map_of_the_points_segment_in_whole_steps(seed: int):
    table = fixed_table(turning(imu_offsets(100), FAST_TURN_RADPS), np.empty((256, 28), np.int32))
    points, t = far_points(600, 80.0, seed)  # more than two blocks
    t[0], t[1] = 0, 100_000_000
    points[2] = [511.9, -511.9, 511.9]  # moved beyond what 24 bits hold
    t[300:] = np.sort(t[300:])  # some in no order, some as a scan has them
    out = np.empty_like(points)
    words = table.words.astype(np.int64)
    deskew_points(points, t, table.shift, table.words, out)
    for p, ti, o in zip(points, t, out, strict=True):
        tick = (int(ti) + (1 << table.shift >> 1)) >> table.shift
        s = max(k for k in range(len(words)) if words[k, 0] <= tick)
        dt = tick - int(words[s, 0])
        M = [int(b) + ((int(m) * dt + (1 << 19)) >> 20) for b, m in zip(words[s, 4:16], words[s, 16:], strict=True)]
        q = [int(np.copysign(np.floor(abs(np.float64(v)) * 2**14 + 0.5), v)) for v in p] + [1 << 21]
        for r in range(3):
            total = sum(M[4 * r + c] * q[c] for c in range(4))
            assert o[r] * 2**14 == max(min((total + (1 << 24)) >> 25, 2**23 - 1), 1 - 2**23)


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
