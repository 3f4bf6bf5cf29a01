"""Kernels against naive twins; also run with NUMBA_DISABLE_JIT=1."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.deskew.fixed_table import fixed_table
from fpga_overlay.driver import _kernels as kernels
from fpga_overlay.driver.self_test import made_scan
from fpga_overlay.driver.tests import naive
from fpga_overlay.golden import features, packet
from fpga_overlay.golden.deskew import deskew
from tests.deskew.motions import FAST_TURN_RADPS, imu_offsets, turning


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
