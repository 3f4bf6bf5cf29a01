"""The network is away: nothing is lost, the robot knows where it has gone meanwhile, and the map does not suffer."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from benchmarks.outage import Cut, by_the_clock
from edge_agent.odometry.outage import UNANCHORED
from edge_agent.odometry.settings import OdometrySettings
from splitslam.bench.drift import drift
from splitslam.bench.in_one_process import Network, Outcome, run_both
from splitslam.evaluate import evaluate
from splitslam.tum import read_tum
from tests import tolerances as bars

SCANS, SILENT_S, SECOND_NS = 180, (7.0, 16.0), 1_000_000_000


def outage(yard1: Path, odometry: bool = True, disable: tuple[str, ...] = ()) -> Outcome:
    network, settings = Network(silent_s=SILENT_S), OdometrySettings(enabled=odometry)
    robot = yard1.with_suffix(".yaml")
    return run_both(yard1, robot, network=network, odometry=settings, disable=disable, max_scans=SCANS)


def silence_ns(out: Outcome) -> tuple[int, int]:
    begin_s, end_s = SILENT_S
    return out.start_ns + int(begin_s * 1e9), out.start_ns + int(end_s * 1e9)


def share(out: Outcome, yard1: Path) -> float:
    """Drift of `odom` during the outage, share of the way."""
    return drift(out.scans_odom.trajectory(), read_tum(yard1.with_suffix(".tum")), *silence_ns(out)).share


def test_nine_seconds_alone_cost_less_than_a_hundredth_of_the_way_and_the_map_nothing(yard1: Path):
    out = outage(yard1)
    truth = read_tum(yard1.with_suffix(".tum"))
    report = out.outages.report()
    assert (report.count, report.alone) == (1, False)
    assert report.seconds == pytest.approx(SILENT_S[1] - SILENT_S[0], abs=0.5)
    assert report.scans["failed"] == 0
    assert report.scans["placed"] >= 80
    found = share(out, yard1)
    assert found <= bars.OUTAGE_DRIFT_SHARE
    assert out.node.jumps["odom_max_m"] <= bars.ODOM_STEP_M
    assert out.node.jumps["odom_max_deg"] <= bars.ODOM_STEP_DEG
    assert len(out.final()) == SCANS
    assert evaluate(out.final(), truth).ate_m <= bars.YARD1_ATE_M
    assert len(out.corrections) == 1
    # the robot's pose in the map, all the time, as it knew it
    assert evaluate(out.imu_map.trajectory(), truth).ate_m <= bars.YARD1_ONLINE_ATE_M
    begin_ns, end_ns = silence_ns(out)
    assert {state for at_ns, state in out.states if begin_ns + SECOND_NS < at_ns < end_ns} == {UNANCHORED}
    # the Imu node alone would be somewhere else
    assert share(outage(yard1, odometry=False), yard1) > 5 * found


def test_without_an_imu_it_is_the_odometry_that_finds_the_way(yard1: Path):
    out = outage(yard1, disable=("imu",))
    assert out.outages.report().scans["failed"] == 0
    in_map, (begin_ns, end_ns) = out.scans_map.trajectory(), silence_ns(out)
    meanwhile = in_map[(in_map.stamps_ns >= begin_ns) & (in_map.stamps_ns < end_ns)]
    assert evaluate(meanwhile, read_tum(yard1.with_suffix(".tum"))).ate_m <= bars.OUTAGE_NO_IMU_ATE_M


@pytest.mark.alone
def test_both_programs_get_over_a_cut_network_by_the_clock(yard1: Path):
    cut = Cut(4.0, 9.0)
    result = by_the_clock(yard1, yard1.with_suffix(".tum"), cut, max_scans=140)
    assert result["lost"] == 0
    assert result["outages"]["count"] >= 1
    assert result["outages"]["scans"]["failed"] == 0
    assert not result["outages"]["alone"]
    assert result["caught_up_s"] <= bars.OUTAGE_CAUGHT_UP_S
    assert result["share"] <= bars.OUTAGE_DRIFT_SHARE
    assert result["odom_max_m"] <= bars.ODOM_STEP_M
    assert result["ate_m"] <= bars.YARD1_ATE_M
    assert math.isfinite(result["outages"]["odometry_ms"]["mean"])
