"""Kernels against naive twins; also run with NUMBA_DISABLE_JIT=1 (tests/codec/test_without_jit.py)."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam import _codec_kernels as kernels
from splitslam import codec
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, feature_set, made_frame


def test_merging_two_sorted_sets_sorts_them_with_corners_first():
    rng = np.random.default_rng(0)
    a, b = feature_set(rng, 40), feature_set(rng, 90)
    order = np.empty(130, np.int32)
    assert kernels.merge(a.ring, a.column, b.ring, b.column, order)
    ring, column = np.concatenate([a.ring, b.ring]), np.concatenate([a.column, b.column])
    np.testing.assert_array_equal(order, np.lexsort((np.arange(130), column, ring)))
    assert not kernels.merge(a.ring[::-1].copy(), a.column, b.ring, b.column, order)


@pytest.mark.parametrize("signed", [True, False])
def test_values_split_into_symbols_and_bits_join_again(signed: bool):
    rng = np.random.default_rng(1)
    values = (rng.integers(0, 2**29, 300) >> rng.integers(0, 29, 300)).astype(np.int32)
    values[:5] = [0, 1, 63, 64, 2**29 - 1]
    if signed:
        values = np.where(rng.random(300) < 0.5, -values, values).astype(np.int32)
    symbols, bits = np.empty(300, np.uint8), np.zeros(300 * 4, np.uint8)
    position = kernels.split(values, signed, symbols, bits, 3)
    back = np.empty(300, np.int32)
    assert kernels.join(symbols, signed, bits, 3, back) == position
    np.testing.assert_array_equal(back, values)
    zigzag = np.where(values < 0, -2 * values.astype(np.int64) - 1, 2 * values.astype(np.int64)) if signed else values
    for u, symbol in zip(zigzag, symbols, strict=True):
        e = int(u).bit_length() - 1
        assert symbol == (u if u < 64 else 64 + (e - 6) * 8 + ((int(u) >> (e - 3)) & 7))
    assert kernels.join(symbols, signed, bits[: position // 8 - 1], 3, back) == -1


def test_a_value_beyond_the_largest_symbol_is_reported():
    symbols, bits = np.empty(1, np.uint8), np.zeros(8, np.uint8)
    assert kernels.split(np.array([2**29], np.int64), True, symbols, bits, 0) == -1


def test_the_rate_of_columns_is_found_for_both_senses_of_rotation():
    for clockwise in (True, False):
        f = feature_set(np.random.default_rng(2), 300, clockwise)
        rates = np.empty(300)
        n = kernels.neighbour_rates(f.ring, f.column, f.t_offset_ns, rates)
        rate = kernels.mean_rate(f.ring, f.column, f.t_offset_ns, float(np.median(rates[:n])))
        assert rate == pytest.approx(-55_555 if clockwise else 55_555, rel=0.01)


def test_a_small_frame_survives_both_kernels():
    frame = made_frame(corners=10, surfs=30)
    got = codec.decode(codec.encode(frame, ELEVATIONS_RAD, COLUMNS), 1, 0, True, ELEVATIONS_RAD)
    assert np.abs(got.surfs.points_lidar - frame.surfs.points_lidar).max() < 0.01
    np.testing.assert_array_equal(got.surfs.column, frame.surfs.column)


def test_predictions_are_integers_that_follow_the_residual():
    fraction = 0
    for _ in range(40):
        fraction = kernels.blend(fraction, 1000, 5)
    assert abs(kernels.predict(fraction, 2000) - 10) <= 1
    assert kernels.blend(fraction, 0, 5) == fraction
    assert abs(kernels.blend(0, 1, 10**6)) <= 1 << 18
