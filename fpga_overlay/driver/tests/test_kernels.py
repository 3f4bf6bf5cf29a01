"""Kernels against naive twins; also run with NUMBA_DISABLE_JIT=1."""

from __future__ import annotations

import numpy as np
import pytest

from fpga_overlay.driver import _kernels as kernels
from fpga_overlay.driver.self_test import made_scan
from fpga_overlay.driver.table import _SCALE, fixed_table
from fpga_overlay.driver.tests import naive
from fpga_overlay.golden import features, packet
from fpga_overlay.golden.deskew import deskew
from tests.deskew.motions import FAST_TURN_RADPS, imu_offsets, turning


@pytest.mark.parametrize("rate_hz", [100, 4000])
def test_the_table_holds_the_poses_at_its_breaks_and_the_slopes_between(rate_hz: float) -> None:
    knots = turning(imu_offsets(rate_hz), FAST_TURN_RADPS)
    breaks = np.empty(256, np.int64)
    breaks = breaks[: kernels.lay_breaks(knots.offsets_ns, 100_000_000, 400_000, breaks)]
    words = np.empty((len(breaks), 28), np.int32)
    assert kernels.fill_table(knots.offsets_ns, knots.rotation, knots.translation_m, breaks, 3, _SCALE, words)
    exact = naive.table(knots, breaks, 3, _SCALE)
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
    assert not kernels.fill_table(knots.offsets_ns, knots.rotation, far, breaks, 3, _SCALE, words)


def test_points_are_packed_with_the_nearest_tick() -> None:
    scan = made_scan(16)
    time = scan.t_offset_ns.copy()
    time[:6] = [0, 3, 4, 11, 2**31 - 1, -7]
    beats = np.empty((len(scan), 4), np.uint32)
    kernels.pack_points(scan.points_lidar.view(np.uint32), time, scan.ring, 3, beats)
    ticks = [min((max(int(t), 0) + 4) // 8, 2**24 - 1) for t in time]
    np.testing.assert_array_equal(beats, packet.point_beats(scan.points_lidar, scan.ring, np.array(ticks)))
    assert ticks[:6] == [0, 0, 1, 1, 2**24 - 1, 0]


@pytest.fixture(scope="module")
def answered() -> tuple[packet.Header, np.ndarray, np.ndarray, np.ndarray]:
    """Header, points of the answer (N, 4), records (M,) and ranges (N,) of a made scan."""
    scan = made_scan(16)
    table = fixed_table(turning(imu_offsets(200), FAST_TURN_RADPS), np.empty((256, 28), np.int32))
    header = packet.Header(16, 1024, len(table.words))
    points = packet.point_beats(scan.points_lidar, scan.ring, scan.t_offset_ns >> table.shift)
    found = deskew(header, table.words, points)
    return header, found.beats(), features.records(header, found)[0], found.range_q


def test_an_image_is_unpacked_from_its_records(answered) -> None:
    _, beats, records, ranges = answered
    n = len(records)
    points, ring, column = np.empty((n, 3), np.float32), np.empty(n, np.uint8), np.empty(n, np.uint16)
    source, ring_start = np.empty(n, np.int32), np.empty(17, np.int32)
    assert kernels.unpack_image(beats, records, 1024, points, ring, column, source, ring_start)
    right = naive.ordered(beats)
    np.testing.assert_array_equal(source, right)
    for j, i in enumerate(right):
        xyz, its_ring, its_column, _, _ = naive.unpack_point(beats[i])
        assert points[j].tolist() == xyz
        assert (ring[j], column[j]) == (its_ring, its_column)
    np.testing.assert_array_equal(ring_start, [int((ring < r).sum()) for r in range(17)])
    range_q = np.empty(n, np.int32)
    kernels.gather_ranges(beats, source, range_q)
    np.testing.assert_array_equal(range_q, ranges[source])


def test_records_are_made_where_the_logic_made_none(answered) -> None:
    _, beats, records, _ = answered
    made, cells = np.zeros(16 * 1024, np.uint64), np.empty((16, 1024), np.int32)
    n = kernels.order_points(beats, cells, made)
    np.testing.assert_array_equal(made[:n], records & np.uint64(2**36 - 1))
    assert kernels.order_points(beats, cells[:, :1000], made) == -1
    assert kernels.order_points(beats, cells[:15], made) == -1


def test_marks_are_unpacked_from_their_bits(answered) -> None:
    records = answered[2]
    n = len(records)
    d, marks, sector = np.empty(n, np.int32), np.empty(n, np.uint8), np.empty(n, np.uint8)
    kernels.unpack_marks(records, d, marks, sector)
    for j, record in enumerate(map(int, records)):
        assert (d[j], sector[j], marks[j]) == (record >> 36 & 0x3FFFFF, record >> 58 & 7, record >> 61)
    assert set(marks) == {0, 1, 2, 4}


def test_flags_are_counted_once_a_point(answered) -> None:
    beats, counts = answered[1], np.empty(2, np.int64)
    kernels.count_flags(beats, counts)
    flags = [naive.unpack_point(b)[3] for b in beats]
    assert counts.tolist() == [sum(f & 2 > 0 for f in flags), sum(f & 6 == 4 for f in flags)]
    assert counts.tolist() == [3, 1]


@pytest.mark.parametrize("what", ["index", "ring", "column", "order", "twice"])
def test_records_that_are_none_are_refused_before_they_are_followed(answered, what: str) -> None:
    _, beats, records, _ = answered
    n = len(records)
    bad = records.copy()
    if what == "index":
        bad[5] |= np.uint64(0x3FFFF)
    elif what == "ring":
        bad[-1] |= np.uint64(0x7F << 29)
    elif what == "column":
        bad[5] |= np.uint64(0x7FF << 18)
    elif what == "order":
        bad[[5, 6]] = bad[[6, 5]]
    else:
        bad[6] = bad[5]
    out = np.empty((n, 3), np.float32), np.empty(n, np.uint8), np.empty(n, np.uint16), np.empty(n, np.int32)
    assert not kernels.unpack_image(beats, bad, 1024, *out, np.empty(17, np.int32))
