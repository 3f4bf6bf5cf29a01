"""Rates, gaps, order of stamps; rings, columns, point times and beams; each mistake alone gives one line."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from splitslam.check import layout, streams
from splitslam.check.findings import Finding, Severity
from splitslam.check.layout import Layout, LayoutProbe
from splitslam.robot import Lidar
from splitslam.scan import Scan

STAMPS_NS = 1_700_000_000_000_000_000 + np.arange(1000) * 5_000_000
LIDAR = Lidar(model="vlp16")
BEAMS_RAD = np.radians(np.arange(-15.0, 16.0, 2.0))


def lines(stamps_ns: np.ndarray, stated_hz: float = 200.0) -> list[Finding]:
    return streams.findings("imu", streams.statistics(stamps_ns), stated_hz)


def test_an_even_stream_gives_no_line() -> None:
    assert lines(STAMPS_NS) == []
    assert streams.statistics(STAMPS_NS).rate_hz == pytest.approx(200.0)


def test_a_rate_that_is_not_the_robot_files_is_one_line() -> None:
    (finding,) = lines(STAMPS_NS, stated_hz=100.0)
    assert (finding.where, finding.expected) == ("imu.rate_hz", "200")


def test_the_rate_of_a_stream_with_holes_is_still_that_of_its_sensor() -> None:
    (finding,) = lines(np.delete(STAMPS_NS, np.s_[200:420]))
    assert finding.where == "imu stamps"
    assert finding.severity is Severity.PROBLEM
    assert "the longest 1.1" in finding.what


def test_a_single_short_hole_is_a_note() -> None:
    (finding,) = lines(np.delete(STAMPS_NS, np.s_[500:505]))
    assert finding.severity is Severity.NOTE
    s = streams.statistics(np.delete(STAMPS_NS, np.s_[500:505]))
    assert (s.gaps, s.longest_gap_s, s.lost_s) == (1, pytest.approx(0.030), pytest.approx(0.025))


def test_stamps_that_go_back_or_repeat_are_counted_one_by_one() -> None:
    swapped = STAMPS_NS.copy()
    swapped[[100, 101, 300, 301, 700, 701]] = swapped[[101, 100, 301, 300, 701, 700]]
    s = streams.statistics(np.append(swapped, swapped[-1]))
    assert (s.backwards, s.duplicates, s.gaps) == (3, 1, 0)
    finding = lines(swapped)[0]
    assert (finding.severity, finding.what) == (Severity.PROBLEM, "3 of 1000 go back in time")


@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_stream_of_hardly_any_messages_has_no_rate_and_no_lines(count: int) -> None:
    assert lines(STAMPS_NS[:count]) == []


def test_stamps_of_two_clocks_are_one_line() -> None:
    assert streams.same_clock(STAMPS_NS[::20], STAMPS_NS) is None
    finding = streams.same_clock(STAMPS_NS[::20] + 3_600_000_000_000, STAMPS_NS)
    assert finding is not None
    assert "3.6e+03 s apart" in finding.what


# --- layout ---------------------------------------------------------------------------------------------------------


def scan(columns: int = 1800, rings: int = 16, beams_rad: np.ndarray = BEAMS_RAD, span_ns: int = 100_000_000) -> Scan:
    azimuth = np.repeat(-2 * np.pi * np.arange(columns) / columns, rings)
    elevation = np.tile(beams_rad[:rings], columns)
    flat = 10.0 * np.cos(elevation)
    points = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), 10.0 * np.sin(elevation)], axis=1)
    t = np.repeat(np.arange(columns) * span_ns // columns, rings).astype(np.int32)
    ring = np.tile(np.arange(rings, dtype=np.uint8), columns)
    return Scan(0, span_ns, points.astype(np.float32), t, ring, np.zeros(len(t), np.uint8))


def seen(one: Scan) -> Layout:
    probe = LayoutProbe(LIDAR)
    probe.add(one)
    probe.add(one)
    return probe.layout()


def said(one: Scan, known: np.ndarray | None = BEAMS_RAD, read: int = 1000, **left_out: int) -> list[str]:
    found = layout.findings(seen(one), LIDAR, 0.1, known, Counter(left_out), read)
    return [f"{f.severity}: {f.line}" for f in found]


def test_a_scan_as_the_robot_file_says_gives_no_line() -> None:
    assert said(scan()) == []
    assert seen(scan()).columns == pytest.approx(1800, rel=0.01)
    assert np.nanmax(np.abs(seen(scan()).elevations_rad - BEAMS_RAD)) < 1e-4


def test_columns_that_come_closer_or_wider_are_one_line() -> None:
    for columns in (900, 3600):
        (line,) = said(scan(columns=columns))
        assert line.startswith(f"problem: lidar.columns: 1800, but points of a ring come {columns}")


def test_rings_without_points_are_a_note_and_half_of_them_a_problem() -> None:
    assert said(scan(rings=14))[0].startswith("note: lidar.rings")
    assert said(scan(rings=8))[0].startswith("problem: lidar.rings: 16, but only 8")


def test_point_times_that_span_no_scan_are_one_line() -> None:
    for span_ns in (10_000_000, 200_000_000):
        (line,) = said(scan(span_ns=span_ns))
        assert line.startswith("problem: lidar point times: span")


def test_point_times_that_go_back_are_one_line() -> None:
    one = scan()
    (line,) = said(replace(one, t_offset_ns=one.t_offset_ns[::-1].copy()))
    assert "go back" in line


def test_a_beam_table_upside_down_is_one_line_that_says_so() -> None:
    (line,) = said(scan(beams_rad=BEAMS_RAD[::-1]))
    assert "16 of 16 rings" in line
    assert "ring 0 is the highest" in line
    assert said(scan(beams_rad=BEAMS_RAD[::-1]), known=None) == []


def test_a_beam_table_with_one_wrong_ring_names_it() -> None:
    table = BEAMS_RAD.copy()
    table[5] += np.radians(2.0)
    (line,) = said(scan(), known=table)
    assert "1 of 16 rings lie elsewhere, ring 5 by 2.0 deg" in line


def test_points_that_are_left_out_are_one_line_each_when_there_are_many() -> None:
    assert said(scan(), gated=100, nan=500) == []
    assert "are the points in metres" in said(scan(), gated=2000)[0]
    assert "are NaN" in said(scan(), nan=20_000)[0]
    assert "ring number that does not exist" in said(scan(), unknown_ring=10)[0]
