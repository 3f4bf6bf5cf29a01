"""Tables V and VI are arithmetic on two series: the scans in software, and the same scans with the cores."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from rich.console import Console

from splitslam.bench import edge_plot, edge_show, paper
from splitslam.bench.edge_result import STAGES, Accelerated, EdgeTimes, Stats, as_dict
from splitslam.bench.paper import A53_FACTOR

SCANS = 50
RNG = np.random.default_rng(1)


def times(lidar: str = "64x2048", fast: bool = True, scale: float = 1.0) -> EdgeTimes:
    """Stages of about 1, 4, 3 and 2 ms; with the cores the deskew's share is 1 ms and the cores take 2 ms."""
    cpu = {stage: scale * (ms + RNG.random(SCANS)) for stage, ms in zip(STAGES, (1.0, 4.0, 3.0, 2.0), strict=True)}
    cpu["total"] = np.sum(list(cpu.values()), axis=0)
    ps = {**cpu, "deskew": np.full(SCANS, 1.0)}
    ps["total"] = sum((ps[stage] for stage in STAGES), np.zeros(SCANS))
    accelerated = Accelerated(ps, np.full(SCANS, 2.0), np.full(SCANS, 11.0))
    return EdgeTimes("walk", lidar, 100_000.0, cpu, accelerated if fast else None)


def series_of(one: EdgeTimes, what: str, how: str) -> np.ndarray:
    ms = one.series()[what][how]
    assert ms is not None
    return ms


def test_the_cores_and_the_processors_share_follow_each_other():
    one = times()
    np.testing.assert_allclose(series_of(one, "deskew", "here_fpga"), 1.0 + 2.0)
    rest = sum(one.cpu_ms[stage] for stage in ("motion", "features", "encode"))
    np.testing.assert_allclose(series_of(one, "edge", "here_fpga"), rest + 1.0 + 2.0)


def test_the_boards_times_are_predicted_from_those_here_by_one_factor():
    one = times()
    np.testing.assert_allclose(series_of(one, "edge", "a53"), A53_FACTOR * one.cpu_ms["total"])
    rest = sum(one.cpu_ms[stage] for stage in ("motion", "features", "encode"))
    np.testing.assert_allclose(series_of(one, "edge", "a53_fpga"), A53_FACTOR * rest + 11.0)
    np.testing.assert_allclose(series_of(one, "deskew", "a53_fpga"), 11.0)


def test_the_share_of_late_scans_is_that_over_the_time_of_a_scan():
    ms = np.array([99.0, 100.0, 101.0, 400.0])
    stats = Stats.of(ms)
    assert stats.over == pytest.approx(0.5)
    assert (stats.mean, stats.max) == (175.0, 400.0)
    assert stats.std == pytest.approx(ms.std())


@pytest.mark.parametrize(("scale", "met"), [(0.9, True), (1.1, False)])
def test_a_bar_is_met_on_one_side_of_it(scale: float, met: bool):
    mean = float(times().cpu_ms["total"].mean())
    assert times(scale=scale * 12.0 / mean).bars()["cpu_mean_ms"]["met"] is met


def test_what_was_not_measured_has_no_verdict_and_other_lidars_have_no_bar():
    assert times(fast=False).bars()["ps_mean_ms"] == {"seen": None, "bar": 6.0, "met": None}
    assert times(lidar="16x1800").bars() == {}


def test_the_terminal_names_what_is_predicted_what_is_measured_and_the_papers_own():
    out = io.StringIO()
    edge_show.show([times(), times(fast=False)], "not measured", Console(file=out, width=100))
    text = out.getvalue()
    for part in (
        "this CPU, measured",
        "A53: predicted, not measured",
        "the paper, on its board",
        "With FPGA: not measur",
    ):
        assert part in text
    for mean, *_ in paper.TABLE_6.values():
        assert f"{mean:.2f}" in text
    assert max(map(len, text.splitlines())) <= 100


def test_the_json_has_both_tables_and_figure_10():
    result = json.loads(json.dumps(as_dict([times(), times(fast=False)], "label"), allow_nan=False))
    with_cores, without = result["recordings"]
    assert len(with_cores["figure_10_ms"]["a53_fpga"]) == SCANS
    assert without["figure_10_ms"]["here_fpga"] is None
    assert with_cores["edge_ms"]["a53"]["mean"] == pytest.approx(A53_FACTOR * with_cores["edge_ms"]["here"]["mean"])
    assert result["paper"]["table_5_ms"]["Walking"]["with_fpga"] == 7.07


def test_the_papers_tables_are_those_that_its_text_speaks_of():
    """Section V-D: 3.46 to 4.31 times on average and up to 10.02 to 13.23 times; the whole edge 1.63 to 1.73 times."""
    mean = [row[0] / row[3] for row in paper.TABLE_5.values()]
    most = [row[2] / row[3] for row in paper.TABLE_5.values()]
    whole = [row[0] / row[1] for row in paper.TABLE_6.values()]
    assert (min(mean), max(mean)) == pytest.approx((3.46, 4.31), abs=0.005)
    assert (min(most), max(most)) == pytest.approx((10.02, 13.23), abs=0.01)
    assert (min(whole), max(whole)) == pytest.approx((1.63, 1.73), abs=0.006)
    assert all(row[2] > 100.0 > row[3] for row in paper.TABLE_6.values())


def test_the_picture_has_a_row_for_each_recording():
    one, two = (edge_plot.draw([times()] * rows) for rows in (1, 2))
    heights = [int.from_bytes(data[20:24], "big") for data in (one, two)]
    assert heights[1] == pytest.approx(2 * heights[0], rel=0.05)
