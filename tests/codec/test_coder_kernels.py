"""The range coder's kernels against naive twins."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from splitslam.codec import (
    _coder_kernels,
)
from splitslam.codec.coder import MOTION, Coder
from splitslam.codec.logistic import RATE, SQUASH


class ExactCoder:
    """The range coder's arithmetic with one unbounded integer for `low`: no carry to look after."""

    def __init__(self) -> None:
        self.low, self.range, self.shifts = 0, 2**56, 0

    def narrow(self, bound: int, bit: int) -> None:
        if not bit:
            self.low += bound
        self.range = bound if bit else self.range - bound
        while self.range < 2**32:
            self.low, self.range, self.shifts = self.low << 24, self.range << 24, self.shifts + 1

    def interval(self) -> tuple[Fraction, Fraction]:
        unit = Fraction(1, 2 ** (56 + 24 * self.shifts))
        return self.low * unit, (self.low + self.range) * unit


@pytest.mark.parametrize("one_in", [2, 30, 4000])
def test_the_bytes_name_a_number_within_the_exact_interval(one_in: int):
    """Rare bits make long runs of 255, through which a carry has to go."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        data, exact = np.zeros(4000, np.uint8), ExactCoder()
        state = Coder(data, False).arrays[0]
        for bit in (rng.integers(0, one_in, 1200) == 0).astype(int):
            bound = max(int(state[_coder_kernels.RANGE]) // one_in, 1)
            _coder_kernels.narrow(state, data, bound, int(bit))
            exact.narrow(bound, int(bit))
        size = _coder_kernels.finish(state, data)
        value = Fraction(int.from_bytes(data[:size].tobytes(), "big"), 256 ** int(size))
        low, high = exact.interval()
        assert low <= value < high


def test_a_carry_goes_through_bytes_of_255_that_are_out():
    data = np.zeros(40, np.uint8)
    state = Coder(data, False).arrays[0]
    state[_coder_kernels.LOW] = 0x7FFFFF << 32
    _coder_kernels._put(state, data)
    state[_coder_kernels.LOW] = 0xFFFFFF << 32
    _coder_kernels._put(state, data)
    assert data[:6].tolist() == [127, 255, 255, 255, 255, 255]
    state[_coder_kernels.LOW] = (1 << 56) + (3 << 32)
    _coder_kernels._put(state, data)
    assert data[:9].tolist() == [128, 0, 0, 0, 0, 0, 0, 0, 3]


def test_numbers_of_every_size_come_back_and_common_ones_are_short():
    rng = np.random.default_rng(1)
    values = rng.integers(0, 2**30, 400) >> rng.integers(0, 30, 400)
    values[:6] = [0, 1, 2, 3, 2**30 - 1, 2**29]
    values = np.where(rng.random(400) < 0.5, -values, values)
    assert coded(values)[1].tolist() == values.tolist()
    assert len(coded(np.zeros(1000, np.int64))[0]) < 8
    assert len(coded(np.full(1000, -7, np.int64))[0]) < 60
    assert 1000 < len(coded(rng.integers(-128, 128, 1000))[0]) < 1100  # 8 bits each, and what learning costs


def coded(values: np.ndarray) -> tuple[bytes, np.ndarray]:
    coder = Coder(np.zeros(100 + 16 * len(values), np.uint8), False)
    coder.numbers(values.astype(np.int64), MOTION)
    data = coder.close()
    back = Coder(np.frombuffer(data, np.uint8).copy(), True)
    result = back.numbers(np.zeros(len(values), np.int64), MOTION)
    back.close()
    return data, result


def test_fields_are_the_bits_they_are():
    values = np.array([5, 0, 2**31 - 1, 1, 2**40 - 3])
    coder = Coder(np.zeros(64, np.uint8), False)
    coder.fields(values, (3, 1, 31, 1, 40))
    data = coder.close()
    assert len(data) <= 11
    back = Coder(np.frombuffer(data, np.uint8).copy(), True)
    assert back.fields(np.zeros(5, np.int64), (3, 1, 31, 1, 40)).tolist() == values.tolist()


def test_a_guess_of_how_many_bits_changes_the_bytes_and_not_the_number():
    rng = np.random.default_rng(2)
    values = rng.integers(-(2**12), 2**12, 300) >> rng.integers(0, 12, 300)
    guesses = rng.integers(1, _coder_kernels.MOST_GUESSED + 1, 300)
    modelled = rng.integers(0, 3, 300)
    coder, where = Coder(np.zeros(2000, np.uint8), False), _coder_kernels.block(0, 1, 2, 3)
    for v, g, m in zip(values, guesses, modelled, strict=True):
        assert _coder_kernels.code_number(*coder.arrays, where, v, True, g, m) == v
    back = Coder(np.frombuffer(coder.close(), np.uint8).copy(), True)
    for v, g, m in zip(values, guesses, modelled, strict=True):
        assert _coder_kernels.code_number(*back.arrays, where, 0, True, g, m) == v


def test_a_bit_costs_what_the_sum_of_its_contexts_says_and_each_learns_from_the_error():
    """The naive twin: logistic regression in floating point, with the same rates."""
    rng = np.random.default_rng(3)
    coder = Coder(np.zeros(2000, np.uint8), False)
    model, odds, met = coder.arrays[2], np.zeros(30), np.zeros(30, int)
    for _ in range(3000):
        contexts = rng.integers(0, 7, 4) + np.array([0, 7, 14, 21])
        bit = int(rng.random() < 0.1 + 0.12 * (contexts[0] % 7))
        chance = np.clip(1 / (1 + np.exp(-np.clip(odds[contexts].sum(), -8, 8))), 48 / 65536, 1 - 48 / 65536)
        _coder_kernels.code_bit(*coder.arrays, tuple(contexts.tolist()), 0, bit)
        odds[contexts] += (bit - chance) * RATE[met[contexts]] / 65536
        met[contexts] = np.minimum(met[contexts] + 1, 63)
        np.testing.assert_allclose((model[contexts] >> 6) / 65536, odds[contexts], atol=0.02)
        np.testing.assert_array_equal(model[contexts] & 63, met[contexts])
    assert np.ptp(odds[:7]) > 1.0  # it has learnt which context the bit depends on


def test_the_table_is_the_logistic_function_and_no_bit_is_certain():
    x = np.arange(-2048, 2049) / 256
    assert np.abs(SQUASH - np.clip(65536 / (1 + np.exp(-x)), 48, 65536 - 48)).max() <= 0.51
    assert np.all(np.diff(RATE) < 0)


def test_levels_grow_by_two_an_octave_and_never_fall():
    levels = [_coder_kernels.level(x) for x in range(-2, 70_000)]
    assert levels[:7] == [0, 0, 0, 1, 2, 3, 4]
    assert all(levels[2 + x] == 2 * (x.bit_length() - 1) + ((x >> (x.bit_length() - 2)) & 1) for x in range(2, 69_990))
    assert _coder_kernels.level(1 << 40) == 43
    assert [_coder_kernels.bits_of(x) for x in (0, 1, 2, 3, 4, 255, 256, 1 << 30)] == [1, 1, 2, 2, 3, 8, 9, 12]
