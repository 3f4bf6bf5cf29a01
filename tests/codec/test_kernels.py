"""Kernels against naive twins; also run with NUMBA_DISABLE_JIT=1 (tests/test_kernels_without_the_jit.py)."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from splitslam import se3
from splitslam._motion_kernels import vector_of
from splitslam.codec import (
    _beam_kernels,
    _coder_kernels,
    _knot_kernels,
    _lattice_kernels,
    _merge_kernels,
    _motion_kernels,
    _point_kernels,
    _version1_kernels,
)
from splitslam.codec._point_kernels import ACROSS, ALONG, CLASS, COLUMN, INTENSITY, LATE, UP
from splitslam.codec.coder import MOTION, OFFSETS, SLOPES, TIMES, Coder
from splitslam.codec.logistic import RATE, SQUASH
from splitslam.features import FeatureSet, Knots, Motion
from splitslam.motion_table import motion_table
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, feature_set, motion
from tests.tolerances import CODEC_TIME_NS

# --- the range coder ------------------------------------------------------------------------------------------


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


# --- points and their beams -----------------------------------------------------------------------------------


def made_points(seed: int = 0, count: int = 120):
    """(features, counts, points) with COLUMN filled."""
    features = feature_set(np.random.default_rng(seed), count)
    points = np.zeros((7, count), np.int32)
    points[COLUMN] = features.column
    return features, np.bincount(features.ring, minlength=len(ELEVATIONS_RAD)).astype(np.int64), points


def directions(step_m: float):
    azimuth = (np.arange(COLUMNS) - COLUMNS // 2) * 2 * np.pi / COLUMNS
    e = ELEVATIONS_RAD.astype(np.float64)
    return np.stack([np.cos(azimuth), np.sin(azimuth)], 1), np.stack([np.cos(e), np.sin(e)], 1), step_m


def pose_at(knots: Knots, t_ns: int) -> np.ndarray:
    """T_start_lidar by slerp between two knots."""
    k = int(np.clip(np.searchsorted(knots.offsets_ns, t_ns, side="right") - 1, 0, len(knots.offsets_ns) - 2))
    a, b = knots.offsets_ns[k], knots.offsets_ns[k + 1]
    f = np.clip((t_ns - a) / (b - a), 0, 1)
    A, B = se3.so3_exp(knots.rotation[k]), se3.so3_exp(knots.rotation[k + 1])
    t = (1 - f) * knots.translation_m[k] + f * knots.translation_m[k + 1]
    return se3.compose(A @ se3.so3_exp(f * se3.so3_log(A.T @ B)), t)


def arrays(features: FeatureSet) -> tuple[np.ndarray, ...]:
    return features.points_lidar, features.ring, features.column, features.t_offset_ns, features.intensity


def merge(a: FeatureSet, b: FeatureSet, rings: int = 16, columns: int = COLUMNS):
    n = len(a) + len(b)
    counts, points = np.empty(rings, np.int64), np.zeros((7, n), np.int32)
    points_lidar, times = np.empty((n, 3), np.float32), np.empty(n, np.int32)
    found = _merge_kernels.merge(arrays(a), arrays(b), columns, counts, points, points_lidar, times)
    return found, counts, points, points_lidar, times


def test_merging_two_sorted_sets_sorts_them_with_corners_first_and_parting_them_is_the_inverse():
    rng = np.random.default_rng(0)
    a, b = feature_set(rng, 40), feature_set(rng, 90)
    b.ring[:3], b.column[:3] = a.ring[:3], a.column[:3]  # the same cell twice, as no selection makes it
    b = FeatureSet(*(x[np.lexsort((b.column, b.ring))] for x in arrays(b)))
    found, counts, points, points_lidar, times = merge(a, b)
    assert found == _merge_kernels.MERGED
    both = [np.concatenate(pair) for pair in zip(arrays(a), arrays(b), strict=True)]
    order = np.lexsort((np.arange(130), both[2], both[1]))
    np.testing.assert_array_equal(counts, np.bincount(both[1], minlength=16))
    np.testing.assert_array_equal(points[CLASS], order < 40)
    np.testing.assert_array_equal(points[COLUMN], both[2][order])
    np.testing.assert_array_equal(points[INTENSITY], (both[4][order].astype(int) + 8) // 17)
    np.testing.assert_array_equal(points_lidar, both[0][order])
    np.testing.assert_array_equal(times, both[3][order])

    back = FeatureSet(*map(np.empty_like, arrays(a))), FeatureSet(*map(np.empty_like, arrays(b)))
    _merge_kernels.part(points, counts, points_lidar, times, arrays(back[0]), arrays(back[1]))
    for sent, got in zip((a, b), back, strict=True):
        for x, y in zip(arrays(sent)[:4], arrays(got)[:4], strict=True):
            np.testing.assert_array_equal(x, y)
        assert np.abs(sent.intensity.astype(int) - got.intensity).max() <= 8


def test_features_out_of_order_or_outside_of_the_image_are_not_merged():
    rng = np.random.default_rng(0)
    a, b = feature_set(rng, 40), feature_set(rng, 90)
    for backwards in (FeatureSet(*(x[::-1].copy() for x in arrays(a))), b):
        assert merge(backwards, FeatureSet(*(x[::-1].copy() for x in arrays(b))))[0] == _merge_kernels.UNSORTED
    assert merge(a, b, rings=15)[0] == _merge_kernels.OUTSIDE
    assert merge(a, b, columns=900)[0] == _merge_kernels.OUTSIDE


def test_points_in_steps_are_the_points_in_the_frames_of_their_beams():
    features, counts, points = made_points()
    knots, step_m = motion().knots, 0.02
    table = motion_table(knots)
    arrays = (table.breaks_ns, table.base, table.slope)
    fractions = np.empty(len(features))
    assert _beam_kernels.to_steps(
        features.points_lidar, counts, features.t_offset_ns, arrays, directions(step_m), points, fractions
    )
    for i in range(len(features)):
        T = pose_at(knots, int(features.t_offset_ns[i]))
        p = T[:3, :3].T @ (features.points_lidar[i] - T[:3, 3])
        a = (int(features.column[i]) - COLUMNS // 2) * 2 * np.pi / COLUMNS
        e = float(ELEVATIONS_RAD[features.ring[i]])
        along = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        across = np.array([-np.sin(a), np.cos(a), 0.0])
        want = np.array([along, across, np.cross(along, across)]) @ p
        np.testing.assert_allclose(points[[ALONG, ACROSS, UP], i], want / step_m, atol=0.51)
        assert fractions[i] == pytest.approx(want[1] / want[0], abs=1e-4)
    back = np.empty((len(features), 3), np.float32)
    _beam_kernels.from_steps(points, counts, features.t_offset_ns, arrays, directions(step_m), back)
    assert np.abs(back - features.points_lidar).max() < np.sqrt(3) * step_m / 2 + 1e-4


def test_points_that_are_not_finite_are_reported():
    features, counts, points = made_points()
    table = motion_table(motion().knots)
    features.points_lidar[7, 1] = np.nan
    arrays = (table.breaks_ns, table.base, table.slope)
    assert not _beam_kernels.to_steps(
        features.points_lidar, counts, features.t_offset_ns, arrays, directions(0.02), points, np.empty(120)
    )


def test_times_follow_the_columns_and_come_back():
    features, counts, points = made_points()
    rate = -55_555 * 256
    sent = features.t_offset_ns.copy()
    assert _beam_kernels.follow_times(counts, rate, sent, points, False)
    assert np.abs(sent.astype(np.int64) - features.t_offset_ns).max() <= CODEC_TIME_NS
    i, t_first, c_first = 0, 0, 0
    for count in counts:  # the naive twin
        t, c = t_first, c_first
        for n in range(count):
            t += (rate * (int(points[COLUMN, i]) - c)) // 256 + 40_000 * int(points[LATE, i])
            c = int(points[COLUMN, i])
            assert sent[i] == t
            if n == 0:
                t_first, c_first = t, c
            i += 1
    got = np.empty_like(sent)
    assert _beam_kernels.follow_times(counts, rate, got, points, True)
    np.testing.assert_array_equal(got, sent)
    points[LATE, 3] = 1 << 17
    assert not _beam_kernels.follow_times(counts, rate, got, points, True)


def test_the_rate_of_columns_is_found_for_both_senses_of_rotation():
    for clockwise in (True, False):
        f = feature_set(np.random.default_rng(2), 300, clockwise)
        counts = np.bincount(f.ring, minlength=len(ELEVATIONS_RAD)).astype(np.int64)
        points, rates = np.zeros((7, 300), np.int32), np.empty(300)
        points[COLUMN] = f.column
        n = _beam_kernels.neighbour_rates(counts, points, f.t_offset_ns, rates)
        rate = _beam_kernels.mean_rate(counts, points, f.t_offset_ns, float(np.median(rates[:n])))
        assert rate == pytest.approx(-55_555 if clockwise else 55_555, rel=0.01)
        assert _beam_kernels.column_rate(counts, points, f.t_offset_ns, 55_555.0) == round(256 * rate)
        assert _beam_kernels.column_rate(counts, points, f.t_offset_ns, 5_000.0) == 256 * np.sign(rate) * 5_000
    assert _beam_kernels.column_rate(np.zeros(3, np.int64), points[:, :0], f.t_offset_ns[:0], 1.0) == 0


def test_the_line_of_a_ring_is_that_of_least_squares_drawn_to_the_one_before():
    rng = np.random.default_rng(3)
    counts, points = np.array([60, 0, 80], np.int64), np.zeros((7, 140), np.int32)
    points[ALONG] = rng.integers(200, 3000, 140)
    points[UP, :60] = np.rint(9.0 - 0.02 * points[ALONG, :60])
    points[UP, 60:] = np.rint(-3.0 + 0.01 * points[ALONG, 60:])
    lines = np.empty((3, 2), np.int64)
    _beam_kernels.fit_lines(counts, points, lines)
    for r, part, before in ((0, slice(0, 60), [0, 0]), (2, slice(60, 140), lines[0] / [4, 16384])):
        A = np.stack([np.ones(counts[r]), points[ALONG, part]], axis=1)
        A, w = np.vstack([A, np.diag([1.0, 500.0])]), np.append(points[UP, part], before * np.array([1.0, 500.0]))
        offset, slope = np.linalg.lstsq(A, w, rcond=None)[0]
        assert lines[r, 0] / 4 == pytest.approx(offset, abs=0.126)
        assert lines[r, 1] / 16384 == pytest.approx(slope, abs=4e-5)
    np.testing.assert_array_equal(lines[1], lines[0])  # an empty ring says nothing new


def test_the_lines_of_rings_pass_the_coder():
    lines = np.cumsum(np.random.default_rng(0).integers(-300, 301, (16, 2)), axis=0)
    coder = Coder(np.zeros(400, np.uint8), False)
    _point_kernels.code_lines(*coder.arrays, OFFSETS, SLOPES, lines.copy())
    back, got = Coder(np.frombuffer(coder.close(), np.uint8).copy(), True), np.zeros_like(lines)
    _point_kernels.code_lines(*back.arrays, OFFSETS, SLOPES, got)
    np.testing.assert_array_equal(got, lines)


def test_the_steps_of_the_phase_add_up_by_columns_apart():
    _, counts, points = made_points(5, 60)
    fractions = np.random.default_rng(0).uniform(-0.0017, 0.0017, 60)
    fractions[11] = 9.0
    sums = np.zeros(200, np.complex128)
    pairs = _lattice_kernels.phase_steps(counts, points, fractions, 0.0035, sums)
    want, ring = np.zeros(200, np.complex128), np.repeat(np.arange(len(counts)), counts)
    seen = 0
    for i in range(60):
        for j in range(max(i - 4, 0), i):
            gap = points[COLUMN, i] - points[COLUMN, j]
            if ring[i] == ring[j] and gap < 200 and 11 not in (i, j):
                want[gap] += np.exp(2j * np.pi * (fractions[i] - fractions[j]) / 0.0035)
                seen += 1
    assert pairs == seen
    np.testing.assert_allclose(sums, want, atol=1e-9)


def test_the_spectrum_is_the_fourier_transform_and_its_strongest_part_is_found_between_bins():
    rng = np.random.default_rng(1)
    values, parts = rng.normal(size=40) + 1j * rng.normal(size=40), np.empty(64, np.complex128)
    _lattice_kernels.spectrum(values, parts)
    np.testing.assert_allclose(parts, np.fft.fft(values, 64), atol=1e-12)
    parts = np.empty(256, np.complex128)
    for turn in (0.1, 0.4051, 0.77, 0.999):
        _lattice_kernels.spectrum(np.exp(2j * np.pi * turn * np.arange(40)), parts)
        place, size = _lattice_kernels.strongest(parts)
        assert abs((place - turn + 0.5) % 1 - 0.5) < 2e-4
        assert 39 < size <= 40.001


def test_points_pass_the_model_whatever_they_are():
    """Random ones, and the largest that there may be: the same integers come out."""
    rng = np.random.default_rng(4)
    for size in (3, 2000, _point_kernels.LARGEST):
        _, counts, points = made_points(6, 90)
        points[0], points[LATE] = rng.integers(0, 2, 90), rng.integers(-2, 3, 90) * (rng.random(90) < 0.2)
        points[[ALONG, ACROSS, UP]] = rng.integers(-size, size + 1, (3, 90))
        points[6] = rng.integers(0, 16, 90)
        scales = np.array([COLUMNS, -55_555 * 256, 1, -5000, 3660, 1], np.int64)
        lines, now = rng.integers(-100, 100, (16, 2)), np.empty(_point_kernels.NOW, np.int64)
        coder = Coder(np.zeros(8192, np.uint8), False)
        _point_kernels.code_counts(*coder.arrays, counts.copy())
        assert _point_kernels.code_points(*coder.arrays, counts, scales, lines, points.copy(), now)
        decoder = Coder(np.frombuffer(coder.close(), np.uint8).copy(), True)
        got_counts, got = np.zeros(16, np.int64), np.zeros_like(points)
        assert _point_kernels.code_counts(*decoder.arrays, got_counts) == 90
        np.testing.assert_array_equal(got_counts, counts)
        assert _point_kernels.code_points(*decoder.arrays, counts, scales, lines, got, now)
        np.testing.assert_array_equal(got, points)


def test_the_ring_below_is_read_at_the_nearest_column_or_between_two_on_one_surface():
    points = np.zeros((7, 4), np.int32)
    points[COLUMN], points[ALONG], points[INTENSITY] = [10, 20, 30, 40], [1000, 1040, 9000, 9000], [1, 2, 3, 4]
    points[CLASS] = [0, 1, 0, 1]
    now = np.zeros(_point_kernels.NOW, np.int64)
    now[_point_kernels._BELOW_END] = 4
    for column, near, shade in (
        (5, 1000, 1),
        (15, 1020, 1),
        (18, 1032, 2),
        (26, 9000, 3),
        (24, 1040, 2),
        (99, 9000, 4),
    ):
        now[_point_kernels._UNDER] = 0
        _point_kernels._look_below(points, column, now)
        assert (now[_point_kernels._NEAR], now[_point_kernels._NEAR_SHADE]) == (near, shade)
        assert now[_point_kernels._NEAR_CLASS] == 1 - shade % 2


# --- knots ----------------------------------------------------------------------------------------------------


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


# --- motion ---------------------------------------------------------------------------------------------------


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


# --- version 1 ------------------------------------------------------------------------------------------------


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
