"""Arithmetic and looks of the partition experiment, on round figures."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import pytest
from rich.console import Console

from splitslam.bench import laz, partition_show
from splitslam.bench.partition_plot import draw
from splitslam.bench.partition_result import A53_FACTOR, Partition, as_dict
from tests.bench.made import PARTITION


def shown(*found: Partition, laz_missing: bool = False) -> str:
    console = Console(width=100, record=True, highlight=False, file=io.StringIO())
    partition_show.show(list(found), laz_missing, console)
    return console.export_text()


def test_rates_and_ratios_are_those_of_tables_3_and_4():
    (recording,) = as_dict([PARTITION], laz_missing=False)["recordings"]
    cases = recording["cases"]
    # 10 scans a second: 400 kB a scan are 32 Mbit/s
    assert cases["case1"]["points_mbps"] == pytest.approx(28.8)
    assert cases["case1"]["imu_mbps"] == pytest.approx(3.2)
    assert [cases[name]["total_mbps"] for name in cases] == pytest.approx([32.0, 33.6, 4.8, 0.32])
    assert [cases[name]["ratio_to_case1"] for name in cases] == pytest.approx([1, 400 / 420, 400 / 60, 100])
    assert [cases[name]["of_case1"] for name in cases] == pytest.approx([1, 1.05, 0.15, 0.01])
    assert cases["ours"]["ratio_to_native"] == pytest.approx(20)
    assert cases["ours"]["ratio_to_laz"] == pytest.approx(5)
    assert recording["laz_bits_per_point"] == pytest.approx(8)


def test_break_evens_count_the_edge_the_packing_and_the_servers_share():
    (recording,) = as_dict([PARTITION], laz_missing=False)["recordings"]
    ours, case3 = recording["cases"]["ours"], recording["cases"]["case3"]
    # 396 kB less to send; 4 ms + 0.5 ms against 0.1 ms + 3 ms
    assert ours["break_even_mbps"] == pytest.approx(396 * 8 / 1.4)
    assert ours["break_even_a53_mbps"] == pytest.approx(396 * 8 / (A53_FACTOR * 4 + 0.5 - A53_FACTOR * 0.1 - 3))
    assert case3["break_even_mbps"] == "always"
    assert recording["cases"]["case2"]["break_even_mbps"] == "never"


def test_figure_12_is_time_plus_bits_over_bandwidth():
    (recording,) = as_dict([PARTITION], laz_missing=False)["recordings"]
    figure = recording["figure_12"]
    assert (figure["bandwidth_mbps"][0], figure["bandwidth_mbps"][-1]) == pytest.approx((1, 200))
    assert figure["measured_ms"]["ours"][0] == pytest.approx(4.5 + 32)
    assert figure["predicted_a53_ms"]["ours"][-1] == pytest.approx(A53_FACTOR * 4 + 0.5 + 32 / 200)


def test_the_tables_fit_100_columns_and_nothing_is_cut():
    text = shown(PARTITION, replace(PARTITION, name="kitti_0005_ring64_4s", native_bytes=None))
    assert max(map(len, text.splitlines())) <= 100
    assert "…" not in text
    assert "67.85 and 125.63 Mbit/s" in text
    assert "A53: predicted, not measured" in text
    assert "as ROS serialises them: 72.0 and 68.0 Mbit/s." in text


def test_without_the_codec_a_line_says_what_to_install():
    text = shown(replace(PARTITION, laz_bytes=None), laz_missing=True)
    assert laz.MISSING in text
    result = as_dict([replace(PARTITION, laz_bytes=None)], laz_missing=True)
    assert result["laz"] is None
    assert result["recordings"][0]["cases"]["ours"]["ratio_to_laz"] is None
    json.dumps(result, allow_nan=False)


def test_the_picture_is_drawn_for_recordings_with_and_without_native_packets():
    one = draw([PARTITION])
    two = draw([PARTITION, replace(PARTITION, native_bytes=None, laz_bytes=None)])
    assert one.startswith(b"\x89PNG")
    assert len(two) > len(one)
