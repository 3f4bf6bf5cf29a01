"""Kernels of knots against naive twins."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam.codec import (
    _knot_kernels,
)
from splitslam.codec.coder import TIMES, Coder


@pytest.mark.parametrize("count", [2, 3, 5, 9, 17, 33])
def test_knots_settle_within_half_a_residual_and_come_back(count: int):
    rng = np.random.default_rng(count)
    values = np.cumsum(np.cumsum(rng.integers(-40, 41, (count, 6)), axis=0), axis=0)
    times = np.arange(count, dtype=np.int64) * 3_000 + rng.integers(0, 900, count)
    for code in (_knot_kernels.halve, lambda *a: _knot_kernels.continue_rate(times, *a)):
        settled, residuals = values.copy(), np.empty(values.size, np.int64)
        code(settled, residuals, False)
        assert np.abs(settled - values).max() <= _knot_kernels.COARSE // 2
        back = np.empty_like(values)
        code(back, residuals.copy(), True)
        np.testing.assert_array_equal(back, settled)
        again = settled.copy()
        code(again, residuals, False)
        np.testing.assert_array_equal(again, settled)


def test_a_cubic_leaves_nothing_between_the_coarsest_knots():
    t = np.linspace(0, 1, 33)[:, None]
    values = np.rint(1e5 * t**3 - 2e4 * t**2 + 3e4 * t * np.arange(6)).astype(np.int64)
    residuals = np.empty(values.size, np.int64)
    _knot_kernels.halve(values, residuals, False)
    assert np.abs(residuals[6 * 17 :]).max() <= 1
    assert np.abs(residuals).max() > 1000


def test_a_constant_rate_leaves_nothing_after_the_second_knot():
    times = np.array([0, 700, 2500, 3000, 9000], np.int64)
    values = times[:, None] * np.arange(1, 7)
    residuals = np.empty(values.size, np.int64)
    _knot_kernels.continue_rate(times, values, residuals, False)
    assert np.abs(residuals[12:]).max() <= 1


@pytest.mark.parametrize("even", [True, False])
def test_knots_that_settle_are_those_that_their_residuals_bring_back(even: bool):
    rng = np.random.default_rng(3)
    times = np.linspace(0, 99_000_000, 33).astype(np.int64)
    knots = rng.normal(0, 0.01, (33, 3)), rng.normal(0, 0.1, (33, 3))
    values, residuals = np.empty((33, 6), np.int64), np.empty(6 * 33, np.int64)
    _knot_kernels.to_units(*knots, values)
    if even:
        _knot_kernels.halve(values, residuals, False)
    else:
        _knot_kernels.continue_rate(times, values, residuals, False)
    expected = np.empty((33, 3)), np.empty((33, 3))
    _knot_kernels.from_units(values, *expected)
    settled = knots[0].copy(), knots[1].copy()
    assert _knot_kernels.settle(times, even, *settled)
    np.testing.assert_array_equal(settled, expected)
    assert np.abs(settled[0] - knots[0]).max() > 1e-6, "each by up to half a residual"
    knots[1][5, 1] = np.nan
    assert not _knot_kernels.settle(times, even, *knots)


def test_units_of_knots_come_back_and_those_beyond_all_bounds_do_not():
    rng = np.random.default_rng(0)
    rotation, translation_m = rng.normal(0, 0.3, (7, 3)), rng.normal(0, 2, (7, 3))
    values = np.empty((7, 6), np.int64)
    assert _knot_kernels.to_units(rotation, translation_m, values)
    np.testing.assert_array_equal(values, np.rint(np.hstack([rotation / 1e-6, translation_m / 2e-5])))
    back = np.empty((7, 3)), np.empty((7, 3))
    assert _knot_kernels.from_units(values, *back)
    np.testing.assert_allclose(back[0], rotation, atol=5.1e-7)
    np.testing.assert_allclose(back[1], translation_m, atol=1.01e-5)
    values[3, 4] = -(1 << 28)
    assert not _knot_kernels.from_units(values, *back)
    for bad in (np.nan, np.inf, 300.0):
        rotation[2, 1] = bad
        assert not _knot_kernels.to_units(rotation, translation_m, values)


def test_times_of_knots_pass_the_coder_and_must_increase():
    times = np.array([0, 700, 2500, 3000, 9000], np.int64) * 1000
    even = np.array([-3000, 5000, 13000], np.int64)
    assert not _knot_kernels.are_even(times)
    assert _knot_kernels.are_even(even)
    coder = Coder(np.zeros(400, np.uint8), False)
    for sent, how in ((times, False), (even, True), (times[::-1], False)):
        assert _knot_kernels.code_times(*coder.arrays, TIMES, sent.copy(), how) == (sent[0] < sent[-1])
    back = Coder(np.frombuffer(coder.close(), np.uint8).copy(), True)
    for sent, how in ((times, False), (even, True), (times[::-1], False)):
        got = np.zeros_like(sent)
        assert _knot_kernels.code_times(*back.arrays, TIMES, got, how) == (sent[0] < sent[-1])
        np.testing.assert_array_equal(got, sent)
