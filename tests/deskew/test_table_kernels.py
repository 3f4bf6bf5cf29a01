"""Kernels of the fixed-point table against naive twins; also run with NUMBA_DISABLE_JIT=1."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.deskew import _kernels as kernels
from edge_agent.deskew.fixed_table import SCALE
from tests.deskew import naive
from tests.deskew.motions import FAST_TURN_RADPS, imu_offsets, turning


@pytest.mark.parametrize("rate_hz", [100, 4000])
def test_the_table_holds_the_poses_at_its_breaks_and_the_slopes_between(rate_hz: float) -> None:
    knots = turning(imu_offsets(rate_hz), FAST_TURN_RADPS)
    breaks = np.empty(256, np.int64)
    breaks = breaks[: kernels.lay_breaks(knots.offsets_ns, 100_000_000, 400_000, breaks)]
    words = np.empty((len(breaks), 28), np.int32)
    assert kernels.fill_table(knots.offsets_ns, knots.rotation, knots.translation_m, breaks, 3, SCALE, words)
    exact = naive.table(knots, breaks, 3, SCALE)
    np.testing.assert_array_equal(words[:, :4], exact[:, :4])
    np.testing.assert_allclose(words[:, 4:16], exact[:, 4:16], atol=0.51)
    np.testing.assert_allclose(words[:, 16:], exact[:, 16:], atol=1.0)  # of 2^-20 of a base's unit
    assert not words[-1, 16:].any()


@pytest.mark.parametrize("rate_hz", [10, 50, 97, 200, 333, 500, 1000, 2000])
def test_breaks_lie_on_even_knots_and_cut_them_evenly(rate_hz: float) -> None:
    offsets = imu_offsets(rate_hz)
    breaks = np.empty(256, np.int64)
    count = kernels.lay_breaks(offsets, int(offsets[-1]), 400_000, breaks)
    assert count <= 256
    assert set(offsets) <= set(breaks[:count])
    steps = np.diff(breaks[:count])
    assert steps.min() > 0
    assert steps.max() <= 1_000_000
    spans = np.searchsorted(offsets, breaks[: count - 1], side="right")
    for span in np.unique(spans):
        assert np.ptp(steps[spans == span]) <= 1


def test_too_many_knots_or_a_hole_among_them_make_even_breaks() -> None:
    breaks = np.empty(256, np.int64)
    many = imu_offsets(4000)
    holed = np.concatenate([np.arange(0, 20_000_000, 100_000), [100_000_000]])
    for offsets in (many, holed):
        assert kernels.lay_breaks(offsets, 100_000_000, 400_000, breaks) == 256
        assert breaks[0] == 0
        assert breaks[-1] == 100_000_000
        assert np.ptp(np.diff(breaks)) <= 1


def test_knots_before_the_scan_are_cut_at_its_start() -> None:
    breaks = np.empty(256, np.int64)
    count = kernels.lay_breaks(np.array([-5_000_000, 1_000_000, 3_000_000]), 3_000_000, 400_000, breaks)
    assert breaks[0] == 0
    assert breaks[count - 1] == 3_000_000
    assert 1_000_000 in breaks[:count]
    assert kernels.parts_of(np.array([-5_000_000, 1_000_000, 3_000_000]), 3_000_000, 400_000) == 3 + 5


def test_motion_beyond_the_fixed_point_is_seen() -> None:
    knots = turning(imu_offsets(100), FAST_TURN_RADPS)
    far = knots.translation_m + np.array([300.0, 0, 0])
    breaks = np.arange(0, 100_000_001, 1_000_000)
    words = np.empty((len(breaks), 28), np.int32)
    assert not kernels.fill_table(knots.offsets_ns, knots.rotation, far, breaks, 3, SCALE, words)
