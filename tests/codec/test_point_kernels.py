"""Kernels of points and beams against naive twins."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam import se3
from splitslam.codec import (
    _beam_kernels,
    _lattice_kernels,
    _merge_kernels,
    _point_kernels,
)
from splitslam.codec._point_kernels import ACROSS, ALONG, CLASS, COLUMN, INTENSITY, LATE, UP
from splitslam.codec.coder import OFFSETS, SLOPES, Coder
from splitslam.features import FeatureSet, Knots
from splitslam.motion_table import motion_table
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, feature_set, motion
from tests.tolerances import CODEC_TIME_NS


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
    values, parts = rng.normal(size=40) + 1j * rng.normal(size=40), np.empty(_lattice_kernels.BINS, np.complex128)
    _lattice_kernels.spectrum(values, parts)
    np.testing.assert_allclose(parts, np.fft.fft(values, len(parts)), atol=1e-12)
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
