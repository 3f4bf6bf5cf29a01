from __future__ import annotations

import socket
import urllib.request
from collections import Counter

import numpy as np
import pytest

from edge_agent.metrics import EdgeMetrics, summary
from edge_agent.odometry.outage import OutageReport
from edge_agent.rate import RateControl, RateSettings
from edge_agent.sources import Counts
from edge_agent.tally import Tally, stage_summaries
from edge_agent.tcp_meter import TcpBytes
from edge_agent.types import OdometryReply
from edge_agent.wire import Answer
from splitslam.errors import InputError


def scrape(port: int) -> dict[str, float]:
    text = urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=30).read().decode()
    lines = [line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#")]
    return {name: float(value) for name, value in lines}


def test_the_report_and_the_metrics_page_have_the_same_numbers():
    metrics = EdgeMetrics()
    port = metrics.serve("127.0.0.1", 0)
    try:
        for k in range(1, 101):
            metrics.stages({"deskew": k * 1.0, "total": k * 2.0}, {"deskew": k * 1.5})
            metrics.round_trip.observe_s(k * 1e-3)
        metrics.drop("nan", 3)
        metrics.sent("frame", 1200)
        page = scrape(port)
    finally:
        metrics.close()
    report = stage_summaries(metrics)
    total_s = page['splitslam_edge_stage_seconds_sum{stage="total"}']
    assert total_s == pytest.approx(report["edge_ms"]["total"]["mean"] * 100 / 1e3)
    assert page['splitslam_edge_stage_seconds_count{stage="deskew"}'] == 100
    assert page["splitslam_edge_round_trip_seconds_sum"] == pytest.approx(report["round_trip_ms"]["mean"] * 0.1)
    assert page['splitslam_edge_dropped_total{reason="nan"}'] == metrics.dropped["nan"] == 3
    assert page['splitslam_edge_uplink_bytes_total{kind="frame"}'] == 1200


def test_the_deskew_back_end_and_its_troubles_are_on_the_page():
    metrics, counts = EdgeMetrics(), Counter({"timeout": 2})
    metrics.deskew_from("fpga", counts)
    port = metrics.serve("127.0.0.1", 0)
    try:
        counts["timeout"] += 1
        page = scrape(port)
    finally:
        metrics.close()
    assert page['splitslam_edge_deskew_back_end{name="fpga"}'] == 1
    assert page['splitslam_edge_deskew_troubles_total{cause="timeout"}'] == 3


def test_outages_and_their_scans_are_on_the_page():
    metrics = EdgeMetrics()
    report = OutageReport(True, 2, 61.5, {"placed": 600, "degenerate": 3, "failed": 1}, 0.02)
    metrics.outages_from(lambda: report)
    port = metrics.serve("127.0.0.1", 0)
    try:
        page = scrape(port)
    finally:
        metrics.close()
    for result, count in report.scans.items():
        assert page[f'splitslam_edge_odometry_scans_total{{result="{result}"}}'] == count
    assert page["splitslam_edge_outages_total"] == 2
    assert page["splitslam_edge_outage_seconds_total"] == 61.5
    assert page["splitslam_edge_alone"] == 1


def test_a_summary_has_mean_spread_and_percentiles():
    values = np.arange(1, 102, dtype=np.float64)
    result = summary(values)
    assert result is not None
    assert result == pytest.approx({"mean": 51.0, "std": values.std(), "p50": 51.0, "p99": 100.0, "max": 101.0})
    assert summary([]) is None


def test_without_a_report_nothing_is_kept():
    metrics = EdgeMetrics(keep=False)
    metrics.round_trip.observe_s(0.1)
    assert len(metrics.round_trip.values_s) == 0


def test_a_taken_port_is_one_line_that_names_the_key():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"^metrics.port {port}: expected a free port"):
            EdgeMetrics().serve("127.0.0.1", port)


def test_rates_go_by_recording_time_and_raw_is_the_papers_case_one():
    tally = Tally()
    tally.sent = 10
    link = tally.link(
        TcpBytes(50_000, 10_000), 2.0, Counts(read_points=1000, imu_messages=100), RateControl(RateSettings(), 300.0)
    )
    raw_bytes = 18 * 1000 + 320 * 100
    assert link["uplink"]["limit_kbps"] == 300.0
    assert link["uplink"]["kbps"] == 200.0
    assert link["uplink"]["bytes_per_scan"] == 5000.0
    assert link["uplink"]["raw_kbps"] == raw_bytes * 8 / 2000
    assert link["uplink"]["native_kbps"] is None
    assert link["uplink"]["ratio_to_raw"] == pytest.approx(raw_bytes / 50_000)
    assert link["downlink"] == {"bytes": 10_000, "kbps": 40.0}


def test_a_scan_whose_place_the_service_did_not_know_counts_as_mapped_and_as_lost():
    tally = Tally()
    for seq, state in enumerate((2, 6, 5, 6), start=1):
        reply = OdometryReply(seq, seq, np.eye(4), np.eye(4), np.eye(6), state, np.zeros((0, 6)))
        tally.answer(Answer(reply, False, None, 0.01))
    assert (tally.mapped, tally.lost) == (4, 2)
