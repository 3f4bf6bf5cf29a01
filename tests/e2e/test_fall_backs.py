"""Each sensor may be missing, silent or half blind: the robot goes on, says so, and is as exact as what is left allows.

The first 17 s of yard1 (3 s standing, then walking, a head turn of 100 degrees), harmed on the way into both pipelines.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge_agent.sources.time_map import shifted
from map_service.types import State
from splitslam import se3
from splitslam.alignment import interpolate
from splitslam.scan import ImuSamples, Scan
from splitslam.tum import read_tum
from tests import tolerances as bars
from tests.e2e.replay import Harm, Replayed, TimedEvent, replay

SCANS = 170
MOVING_S = 12.0


def without_imu(from_s: float, to_s: float) -> Harm:
    def harm(events: Iterator[TimedEvent]) -> Iterator[TimedEvent]:
        start_ns = None
        for arrival_ns, event in events:
            start_ns = arrival_ns if start_ns is None else start_ns
            if not (isinstance(event, ImuSamples) and from_s <= (arrival_ns - start_ns) * 1e-9 < to_s):
                yield arrival_ns, event

    return harm


def losing_scans(share: float) -> Harm:
    def harm(events: Iterator[TimedEvent]) -> Iterator[TimedEvent]:
        rng = np.random.default_rng(1)
        for arrival_ns, event in events:
            if not (isinstance(event, Scan) and rng.random() < share):
                yield arrival_ns, event

    return harm


def half_blocked(events: Iterator[TimedEvent]) -> Iterator[TimedEvent]:
    """Something stands before the sensor: nothing comes back from all that is ahead."""
    for arrival_ns, event in events:
        if isinstance(event, Scan):
            kept = event.points_lidar[:, 0] < 0
            columns = {
                name: getattr(event, name)[kept] for name in ("points_lidar", "t_offset_ns", "ring", "intensity")
            }
            event = replace(event, **columns)
        yield arrival_ns, event


def with_other_clocks(events: Iterator[TimedEvent]) -> Iterator[TimedEvent]:
    """After 7 s somebody sets the wall clock back by an hour; from 10 s to 12 s the LiDAR is unplugged, and when it is
    back its driver counts from another zero."""
    start_ns = None
    for arrival_ns, event in events:
        start_ns = arrival_ns if start_ns is None else start_ns
        after_s = (arrival_ns - start_ns) * 1e-9
        by_ns = -3600 * 10**9 if after_s >= 7.0 else 0
        if isinstance(event, Scan):
            if 10.0 <= after_s < 12.0:
                continue
            by_ns -= 10**17 if after_s >= 12.0 else 0
        yield arrival_ns, shifted(event, by_ns)


def check(result: Replayed, recording: Path, ate_m: float, step_m: float, mapped: int = SCANS) -> None:
    """Nothing died or was lost silently; the poses are as exact as promised, and `odom` moves as the robot does."""
    truth = recording.with_suffix(".tum")
    assert len(result.stamps_ns) == mapped
    assert not result.dropped
    assert set(result.states) <= {State.INITIALISING, State.TRACKING}
    assert result.states[10:] == [State.TRACKING] * (mapped - 10)
    assert result.evaluation(truth).ate_m <= ate_m
    assert result.evaluation(truth, final=False).ate_m <= ate_m
    assert result.jumps["odom_max_m"] <= bars.ODOM_STEP_M
    assert result.jumps["odom_max_deg"] <= bars.ODOM_STEP_DEG
    assert odom_error_m(result, truth).max() <= step_m


def odom_error_m(result: Replayed, truth: Path) -> np.ndarray:
    """By how much each step of T_odom_lidar from scan to scan is off: what the node itself does not judge."""
    reference = interpolate(read_tum(truth), np.array(result.stamps_ns))
    true = [se3.from_quat(p, q) for p, q in zip(reference.positions_m, reference.quats_xyzw, strict=True)]
    odom = result.T_odom_lidar
    steps = [
        se3.inv(se3.inv(true[k - 1]) @ true[k]) @ se3.inv(odom[k - 1]) @ odom[k]
        for k in range(1, len(result.stamps_ns))
    ]
    return np.array([np.linalg.norm(T[:3, 3]) for T in steps])


def test_without_an_imu_the_motion_goes_on_as_it_was(yard1):
    check(replay(yard1, max_scans=SCANS, disable=("loops", "imu")), yard1, bars.NO_IMU_ATE_M, bars.NO_IMU_STEP_M)


def test_without_gnss_the_map_is_as_exact(yard1):
    result = replay(yard1, max_scans=SCANS, disable=("loops", "gnss"))
    check(result, yard1, bars.HARMED_ATE_M, bars.IMU_STEP_M)
    assert result.pipeline is not None
    assert result.pipeline.statistics()["gnss_factors"] == 0


def test_an_imu_that_drops_out_for_a_second_in_motion_costs_millimetres(yard1):
    result = replay(yard1, without_imu(MOVING_S, MOVING_S + 1.0), max_scans=SCANS)
    check(result, yard1, bars.HARMED_ATE_M, bars.NO_IMU_STEP_M)
    assert result.uncovered == 0  # the scans have waited for it


def test_an_imu_that_falls_silent_for_good_leaves_the_lidar(yard1):
    result = replay(yard1, without_imu(MOVING_S, np.inf), max_scans=SCANS)
    check(result, yard1, bars.NO_IMU_ATE_M, bars.NO_IMU_STEP_M)
    assert result.uncovered == pytest.approx(SCANS - 10 * MOVING_S, abs=2)


def test_an_imu_that_never_speaks_leaves_the_lidar(yard1):
    result = replay(yard1, without_imu(-np.inf, np.inf), max_scans=SCANS)
    check(result, yard1, bars.NO_IMU_ATE_M, bars.NO_IMU_STEP_M)
    assert result.uncovered == SCANS


def test_an_imu_that_comes_late_is_used_from_then_on(yard1):
    result = replay(yard1, without_imu(-np.inf, 5.0), max_scans=SCANS)
    check(result, yard1, bars.HARMED_ATE_M, bars.NO_IMU_STEP_M)
    assert result.uncovered == pytest.approx(50, abs=2)


def test_a_fifth_of_the_scans_lost_is_bridged_by_the_imu(yard1):
    lost = replay(yard1, losing_scans(0.2), max_scans=SCANS)
    mapped = len(lost.stamps_ns)
    assert 0.7 * SCANS < mapped < 0.9 * SCANS
    check(lost, yard1, bars.HARMED_ATE_M, bars.IMU_STEP_M, mapped)


def test_half_the_field_of_view_is_enough(yard1):
    check(replay(yard1, half_blocked, max_scans=SCANS), yard1, bars.HARMED_ATE_M, bars.IMU_STEP_M)


def test_clocks_that_step_and_a_lidar_that_comes_back_are_not_felt(yard1):
    result = replay(yard1, with_other_clocks, max_scans=SCANS)
    check(result, yard1, bars.HARMED_ATE_M, bars.NO_IMU_STEP_M, mapped=len(result.stamps_ns))
    assert len(result.stamps_ns) == pytest.approx(SCANS - 20, abs=1)
    assert result.outcome.sequencer.times.steps == {"lidar": 2, "imu": 1, "gnss": 1}
