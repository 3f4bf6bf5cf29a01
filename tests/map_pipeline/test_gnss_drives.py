"""GNSS in the whole map pipeline: what the robot is answered must not feel a receiver's faults."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest

from map_service.types import Cause
from tests import tolerances
from tests.map_pipeline.made_drives import (
    Fault,
    Odometry,
    Outcome,
    Receiver,
    ahead,
    driven,
    fixes,
    rounds,
)

GOOD = Odometry(drift=(0, 0, 2e-5, 0.002, 0, 0.001))  # 2 per mille
POOR = Odometry(drift=(0, 0, 5e-5, 0.01, 0, 0.005))
METRES = Receiver()
RTK = Receiver(sigma_m=0.02, slow_m=0.01, white_m=0.01)
RECEIVERS = {"metres": METRES, "rtk": RTK}
ASIDE = np.array([12.0, -9.0, 0.0])


def jump(from_s: float, to_s: float, by_m: np.ndarray) -> Fault:
    return lambda t_s: by_m * (from_s <= t_s < to_s)


def ramp(from_s: float, to_s: float, by_mps: np.ndarray) -> Fault:
    return lambda t_s: by_mps * (t_s - from_s) * (from_s <= t_s < to_s)


FAULTS = {
    "while the datum is being found": jump(1.0, 7.0, ASIDE),
    "right after it was found": jump(6.0, 12.0, ASIDE),
    "late": jump(50.0, 56.0, ASIDE),
    "in height": jump(50.0, 56.0, np.array([0.0, 0.0, 15.0])),
    "creeping": ramp(40.0, 46.0, np.array([0.4, -0.3, 0.0])),
    "wrong from the start": jump(0.0, 15.0, ASIDE),
    "for a minute": jump(30.0, 90.0, ASIDE),
}


@cache
def undisturbed(kind: str, speed_mps: float) -> Outcome:
    truth = rounds({1.4: 140.0, 10.0: 700.0}[speed_mps], speed_mps)
    return driven(truth, fixes(truth, RECEIVERS[kind]), GOOD)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("kind", RECEIVERS)
def test_a_fault_of_the_receiver_does_not_move_the_map(kind, fault):
    truth = rounds(140.0, 1.4)
    faulty = driven(truth, fixes(truth, RECEIVERS[kind], FAULTS[fault]), GOOD)
    assert faulty.pipeline.stats.gnss_factors > 10  # it did not win by not listening
    assert faulty.moved_m(undisturbed(kind, 1.4)) < tolerances.GNSS_JUMP_MOVES_MAP_M
    assert max(c.translation_m for c in faulty.corrections) < tolerances.GNSS_JUMP_MOVES_MAP_M


@pytest.mark.parametrize("kind", RECEIVERS)
def test_nor_does_it_at_the_speed_of_a_car(kind):
    truth = rounds(700.0, 10.0)
    faulty = driven(truth, fixes(truth, RECEIVERS[kind], FAULTS["late"]), GOOD)
    assert faulty.moved_m(undisturbed(kind, 10.0)) < tolerances.GNSS_JUMP_MOVES_MAP_M


@pytest.mark.parametrize(
    "receiver", [Receiver(rate_hz=1.0), Receiver(rate_hz=10.0), Receiver(sigma_m=None), Receiver(sigma_m=0.0)], ids=str
)
def test_rates_and_receivers_that_say_nothing_change_nothing_about_it(receiver):
    truth = rounds(140.0, 1.4)
    calm = driven(truth, fixes(truth, receiver), GOOD)
    faulty = driven(truth, fixes(truth, receiver, FAULTS["late"]), GOOD)
    assert faulty.pipeline.stats.gnss_factors > 10
    assert faulty.moved_m(calm) < tolerances.GNSS_JUMP_MOVES_MAP_M


def test_nor_does_a_lever_arm_that_is_half_a_metre_wrong():
    truth = rounds(140.0, 1.4)
    lever_m = (0.3, 0.4, 0.3)
    calm = driven(truth, fixes(truth, METRES), GOOD, lever_m)
    faulty = driven(truth, fixes(truth, METRES, FAULTS["late"]), GOOD, lever_m)
    assert faulty.moved_m(calm) < tolerances.GNSS_JUMP_MOVES_MAP_M
    # and what it costs is no more than the lever itself
    assert calm.moved_m(undisturbed("metres", 1.4)) < 0.5


def test_with_exact_odometry_metres_class_gnss_leaves_the_map_alone():
    truth = rounds(140.0, 1.4)
    outcome = driven(truth, fixes(truth, METRES))
    assert outcome.errors_m(outcome.online).max() < 0.1
    assert max((c.translation_m for c in outcome.corrections), default=0.0) < 0.02


def test_rtk_takes_the_drift_out_of_a_long_drive():
    truth = ahead(800.0, 8.0)
    alone = driven(truth, [], POOR)
    helped = driven(truth, fixes(truth, RTK), POOR)
    assert alone.ate_m(alone.final) > 1.5
    assert helped.ate_m(helped.final) < 0.05 * alone.ate_m(alone.final)
    assert helped.ate_m(helped.online) < 0.1 * alone.ate_m(alone.online)


def test_metres_class_gnss_bounds_the_drift_at_a_few_sigmas():
    truth = ahead(2000.0, 10.0, rate_hz=2.0)
    alone = driven(truth, [], POOR, rate_hz=2.0)
    helped = driven(truth, fixes(truth, METRES, rate_hz=2.0), POOR, rate_hz=2.0)
    assert alone.ate_m(alone.final) > 4.0
    assert helped.ate_m(helped.final) < 0.4 * alone.ate_m(alone.final)


def test_after_a_gap_gnss_comes_back_and_corrects_what_drifted_meanwhile():
    truth = ahead(600.0, 8.0)
    given = [fix for fix in fixes(truth, RTK) if not 20 < fix.stamp_ns * 1e-9 < 50]
    outcome = driven(truth, given, GOOD)
    assert any(m > 50 for m in _used_s(outcome))
    assert outcome.ate_m(outcome.final) < 0.2


def test_duplicates_and_fixes_out_of_order_are_counted_and_harmless():
    truth = rounds(140.0, 1.4)
    given = fixes(truth, METRES)
    disorder = [fix for k, fix in enumerate(given) for fix in ([fix, fix, given[k - 1]] if k % 2 else [fix])]
    outcome = driven(truth, disorder, GOOD)
    rejected = outcome.pipeline.statistics()["gnss_rejected"]
    assert rejected["duplicate"] == rejected["out_of_order"] == len(given) // 2
    assert outcome.moved_m(undisturbed("metres", 1.4)) < 0.05


def test_corrections_by_gnss_say_so_and_how_far_they_went():
    truth = rounds(140.0, 1.4)
    outcome = driven(truth, fixes(truth, RTK), POOR)
    assert {c.cause for c in outcome.corrections} == {Cause.GNSS}
    assert len(outcome.corrections) == outcome.pipeline.statistics()["corrections"]["gnss"]
    steps = np.linalg.norm(np.diff(outcome.online[:, :3, 3], axis=0), axis=1)
    assert outcome.pipeline.stats.largest_correction_m >= steps.max() - 1.4 / 5.0 * 1.02


def test_a_session_restored_half_way_goes_on_as_if_nothing_had_happened():
    truth = rounds(140.0, 1.4)
    straight = driven(truth, fixes(truth, RTK, FAULTS["late"]), GOOD)
    halved = driven(truth, fixes(truth, RTK, FAULTS["late"]), GOOD, restart_at=260)
    assert halved.moved_m(straight) < 0.02  # iSAM2 linearises where a pose was, the restored graph where it is
    again, before = halved.pipeline, straight.pipeline
    assert again.statistics()["gnss_rejected"] == before.statistics()["gnss_rejected"]
    assert [json.loads(r.payload)["enu"] for r in again.graph.records if r.kind == "gnss"] == [
        json.loads(r.payload)["enu"] for r in before.graph.records if r.kind == "gnss"
    ]


def _used_s(outcome: Outcome) -> list[float]:
    stamps = {f.keyframe: f.stamp_ns * 1e-9 for f in outcome.pipeline.frames}
    return [stamps[json.loads(r.payload)["keyframe"]] for r in outcome.pipeline.graph.records if r.kind == "gnss"]
