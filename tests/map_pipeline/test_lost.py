"""A robot that is put elsewhere, unfelt by its IMU, in the made room of naive.py."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from map_service.carried import CarriedScans
from map_service.doubt import Doubt, Verdict
from map_service.loops import LoopVerifier
from map_service.pipeline import MapPipeline
from map_service.settings import DoubtSettings, PipelineSettings
from map_service.types import Cause, MapAnswer, State
from map_service.wide_search import Fit, Place
from splitslam import se3
from splitslam.features import FeatureFrame
from splitslam.robot import Robot
from tests.map_pipeline.test_tracker import STEP, features, frame

T_START = se3.compose(np.eye(3), np.array([-1.0, -0.5, 1.2]))
KIDNAP = se3.exp(np.array([0, 0, 0.6, 1.5, -2.0, 0.0]))  # 2.5 m, 34 degrees
USUAL = 20  # scans before anything happens
NEVER = 99


class NoLoops(LoopVerifier):
    def submit(self, job):
        raise AssertionError("loops are off")


def pipeline() -> MapPipeline:
    return MapPipeline(Robot(imu=None, gnss=None), PipelineSettings(), NoLoops(), frozenset({"loops", "gnss"}))


def truth(seq: int, kidnapped_at: int = USUAL + 1) -> np.ndarray:
    T = T_START @ np.linalg.matrix_power(STEP, seq - 1)
    return T if seq < kidnapped_at else T_START @ np.linalg.matrix_power(STEP, kidnapped_at - 1) @ KIDNAP @ (
        np.linalg.matrix_power(STEP, seq - kidnapped_at)
    )  # fmt: skip


def drive(service: MapPipeline, seqs: range, rng: np.random.Generator) -> list[MapAnswer]:
    return [service.process(frame(seq, truth(seq), rng)) for seq in seqs]


def error_m(answer: MapAnswer, kidnapped_at: int = USUAL + 1) -> float:
    T = se3.inv(truth(1)) @ truth(answer.seq, kidnapped_at)
    return float(np.linalg.norm((se3.inv(answer.T_map_lidar) @ T)[:3, 3]))


def test_a_kidnapped_robot_is_lost_at_once_and_found_three_scans_later():
    service = pipeline()
    answers = drive(service, range(1, USUAL + 8), np.random.default_rng(4))
    states = [a.state for a in answers[USUAL:]]
    assert State.LOST not in [a.state for a in answers[:USUAL]]
    assert states == [State.LOST, State.LOCALISING, State.LOCALISING, *[State.TRACKING] * 4]
    assert max(error_m(a) for a in answers[:USUAL] + answers[USUAL + 3 :]) < 0.03


def test_while_lost_the_covariance_covers_the_error_and_nothing_enters_the_map():
    service = pipeline()
    answers = drive(service, range(1, USUAL + 4), np.random.default_rng(4))
    for answer in answers[USUAL : USUAL + 3]:
        assert error_m(answer) > 2.0
        assert np.sqrt(np.diag(answer.covariance)[3:]).min() > 2.0
        assert len(answer.degenerate_axes) == 6
        assert not answer.keyframe


def test_the_jump_is_the_map_s_and_odom_never_notices():
    service = pipeline()
    answers = drive(service, range(1, USUAL + 8), np.random.default_rng(4))
    odom = [se3.inv(a.T_map_odom) @ a.T_map_lidar for a in answers]
    steps = [se3.inv(a) @ b for a, b in itertools.pairwise(odom)]
    assert max(np.linalg.norm((se3.inv(STEP) @ step)[:3, 3]) for step in steps) < 0.03
    corrections = [a.correction for a in answers if a.correction is not None]
    assert [c.cause for c in corrections] == [Cause.RELOCALISE]
    found = next(a for a in answers if a.correction is not None)
    off = se3.inv(truth(found.seq, kidnapped_at=99)) @ truth(found.seq)
    assert corrections[0].translation_m == pytest.approx(np.linalg.norm(off[:3, 3]), abs=0.05)


def test_a_lost_session_goes_on_where_it_was_after_a_restart():
    service = pipeline()
    drive(service, range(1, USUAL + 3), np.random.default_rng(4))
    doubt = Doubt(DoubtSettings())
    doubt.load(json.loads(json.dumps(service.tracker.doubt.dump())))
    assert doubt.state.lost
    assert doubt.dump() == service.tracker.doubt.dump()
    service.tracker.doubt = doubt
    later = np.random.default_rng(5)
    assert drive(service, range(USUAL + 3, USUAL + 5), later)[-1].state == State.TRACKING


def final_errors_m(service: MapPipeline, kidnapped_at: int = USUAL + 1) -> list[float]:
    """Of every scan, as the trajectory has it now."""
    return [
        float(np.linalg.norm((se3.inv(T) @ se3.inv(truth(1)) @ truth(seq, kidnapped_at))[:3, 3]))
        for seq, _, T in service.trajectory()
    ]


def test_scans_of_a_lost_robot_get_their_place_when_it_is_found():
    service = pipeline()
    answers = drive(service, range(1, USUAL + 8), np.random.default_rng(4))
    assert error_m(answers[USUAL]) > 2.0  # the answer is given
    assert max(final_errors_m(service)) < 0.03


def test_scans_that_a_commit_has_taken_get_their_place_with_a_later_one():
    service, rng = pipeline(), np.random.default_rng(4)
    drive(service, range(1, USUAL + 3), rng)
    taken = {f.seq: f.T_keyframe_lidar for f in service.take_commit().frames}
    drive(service, range(USUAL + 3, USUAL + 8), rng)
    commit = service.take_commit()
    assert [seq for seq, _ in commit.frames_again] == [USUAL + 1, USUAL + 2]
    final = {f.seq: f.T_keyframe_lidar for f in service.frames}
    for seq, T in commit.frames_again:
        assert np.linalg.norm((T - taken[seq])[:3, 3]) > 2.0
        np.testing.assert_array_equal(T, final[seq])
    np.testing.assert_array_equal(commit.frames[0].T_keyframe_lidar, final[USUAL + 3])
    assert service.take_commit().frames_again == []


def test_scans_from_before_a_restart_get_their_place_by_the_robot_s_own_motion():
    service, rng = pipeline(), np.random.default_rng(4)
    drive(service, range(1, USUAL + 3), rng)
    carried = CarriedScans()
    carried.load(json.loads(json.dumps(service.tracker.carried.dump())))
    service.tracker.carried = carried
    drive(service, range(USUAL + 3, USUAL + 8), rng)
    assert max(final_errors_m(service)) < 0.05


def test_a_robot_that_nobody_saw_coming_is_not_believed_where_it_fits_first():
    """1.2 m from where it was: the scan registers there, and stays where it was put for good."""
    service, rng, unseen = pipeline(), np.random.default_rng(4), se3.exp(np.array([0, 0, 0.1, 1.2, 0.3, 0.0]))

    def at(seq: int) -> np.ndarray:
        before = np.linalg.matrix_power(STEP, min(seq, USUAL) - 1)
        return T_START @ before @ (unseen @ np.linalg.matrix_power(STEP, seq - USUAL - 1) if seq > USUAL else np.eye(4))

    states = []
    for seq in range(1, USUAL + 8):
        known = seq <= USUAL
        seen = frame(seq, at(seq), rng, known=known, skew=None if known else STEP[:3, 3] / 0.1)
        if seq == USUAL + 1:
            far = np.diag(np.repeat([1.5**2, 10.0**2], 3))
            seen = replace(seen, motion=replace(seen.motion, covariance=far))
        states.append(service.process(seen).state)
    assert states[USUAL : USUAL + 3] == [State.LOST, State.LOCALISING, State.LOCALISING]
    assert states[USUAL + 3 :] == [State.INITIALISING] * 4  # found; its velocity is not known yet
    errors = [
        float(np.linalg.norm((se3.inv(T) @ se3.inv(at(1)) @ at(seq))[:3, 3])) for seq, _, T in service.trajectory()
    ]
    assert max(errors) < 0.03


def test_someone_in_the_way_makes_no_lost_robot():
    """For half a second three quarters of the points are on people, unknown to the map."""
    service, rng = pipeline(), np.random.default_rng(4)
    states = []
    for seq in range(1, USUAL + 8):
        seen = frame(seq, T_START @ np.linalg.matrix_power(STEP, seq - 1), rng)
        if USUAL < seq <= USUAL + 5:
            surfs = seen.surfs.points_lidar.copy()
            surfs[: len(surfs) // 3] *= 0.4
            seen = type(seen)(
                seen.seq, seen.stamp_ns, seen.dense, seen.motion, seen.corners, features(surfs, seen.surfs.t_offset_ns)
            )
        states.append(service.process(seen).state)
    assert State.LOST not in states
    assert states[-1] == State.TRACKING


def facing_a_wall(seq: int, rng: np.random.Generator) -> FeatureFrame:
    """Scans up to USUAL lack the left half of the wall at x = 6 m, the six after them show nothing but its middle."""
    seen, T = frame(seq, truth(seq, NEVER), rng), truth(seq, NEVER)
    if USUAL < seq <= USUAL + 6:
        wall = np.column_stack([rng.normal(6.0, 0.01, 900), rng.uniform(-1.2, 1.6, 900), rng.uniform(0.5, 2.0, 900)])
        return replace(seen, corners=features(np.zeros((0, 3))), surfs=features((wall - T[:3, 3]) @ T[:3, :3]))
    surfs = seen.surfs.points_lidar
    x, y, _ = (surfs @ T[:3, :3].T + T[:3, 3]).T
    return replace(seen, surfs=features(surfs[(x < 5.8) | (y < -0.5)])) if seq <= USUAL else seen


def test_a_robot_that_faces_one_wall_is_not_taken_to_another():
    """Most of what it sees is new; elsewhere, along any wall, the scan would fit as a whole."""
    service, rng = pipeline(), np.random.default_rng(4)
    answers = [service.process(facing_a_wall(seq, rng)) for seq in range(1, USUAL + 14)]
    states = [a.state for a in answers]
    assert State.LOST not in states
    assert State.LOCALISING not in states
    assert states[USUAL : USUAL + 6] == [State.DEGENERATE] * 6
    assert states[-5:] == [State.TRACKING] * 5
    assert max(error_m(a, NEVER) for a in answers) < 0.1


def places(*scores: float) -> list[Place]:
    return [Place(se3.compose(np.eye(3), np.array([5.0 * i, 0, 0])), Fit(s, 1500)) for i, s in enumerate(scores)]


def lost_doubt() -> Doubt:
    doubt = Doubt(DoubtSettings())
    for _ in range(15):
        assert doubt.weigh(Fit(0.8, 1500)) == Verdict.TRUSTED
    doubt.lose(np.eye(4))
    return doubt


def test_of_two_rooms_alike_neither_is_believed_even_when_one_falls_behind():
    doubt = lost_doubt()
    doubt.consider(places(0.8, 0.78))
    assert [doubt.confirm(places(0.8, 0.78)) for _ in range(12)] == [None] * 12
    assert [doubt.confirm(places(0.8, 0.2)[: len(doubt.state.hypotheses)]) for _ in range(8)] == [None] * 8


def test_a_place_that_stands_out_is_believed_after_three_scans():
    doubt = lost_doubt()
    doubt.consider(places(0.8, 0.5))
    assert [doubt.confirm(places(0.8, 0.4)) for _ in range(3)] == [None, None, 0]


def test_a_scan_that_fits_anywhere_is_no_reason_to_go_elsewhere():
    doubt = lost_doubt()
    doubt.found()
    here, there = places(0.2, 0.8)
    assert doubt.is_elsewhere(here, [there])
    assert not doubt.is_elsewhere(here, [replace(there, fit=replace(there.fit, tells=False))])


def test_a_scan_that_fits_anywhere_decides_nothing_between_two_places():
    doubt = lost_doubt()
    doubt.consider(places(0.8, 0.7))
    assert [doubt.confirm(places(0.8, 0.78)) for _ in range(3)] == [None] * 3
    blind = [replace(p, fit=replace(p.fit, tells=False)) for p in places(0.8, 0.1)]
    assert [doubt.confirm(blind) for _ in range(5)] == [None] * 5
    assert len(doubt.state.hypotheses) == 2
    assert doubt.confirm(places(0.8, 0.1)) == 0


def test_scans_with_many_more_features_have_a_level_of_their_own():
    doubt = Doubt(DoubtSettings())
    for _ in range(15):
        doubt.weigh(Fit(0.8, 1500))
    verdicts = [doubt.weigh(Fit(0.35, 7000)) for _ in range(15)]
    assert verdicts == [Verdict.UNKNOWN] * 10 + [Verdict.TRUSTED] * 5
    assert doubt.weigh(Fit(0.35, 1500)) == Verdict.REFUSED
    assert doubt.weigh(Fit(0.55, 1500)) == Verdict.DOUBTED


def test_new_ground_is_what_the_world_looks_like_after_some_doubt():
    doubt = Doubt(DoubtSettings())
    for _ in range(15):
        doubt.weigh(Fit(0.8, 1500))
    assert [doubt.weigh(Fit(0.5, 1500)) for _ in range(4)] == [Verdict.DOUBTED] * 3 + [Verdict.TRUSTED]
