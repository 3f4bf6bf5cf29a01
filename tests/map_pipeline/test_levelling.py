from __future__ import annotations

import itertools
import json

import numpy as np
import pytest

from map_service.graph import PoseGraph
from map_service.levelling import DOWN, Leveller, Tilt
from map_service.settings import GraphSettings, LevelSettings
from map_service.types import Cause
from splitslam import se3
from tests.map_pipeline.made_drives import Odometry, ahead, driven, rounds

TILT = float(np.radians(4.0))
EXACT = Odometry()
TILTED = Odometry(first_tilt_rad=TILT)
PITCHING = Odometry(drift=(0.0, 1e-4, 0.0, 0.0, 0.0, 0.0))  # 0.57 degrees in 100 m


def tilt_rad(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(n,): angle between up in `map` and up in the true map, seen from each pose."""
    up = np.einsum("nij,nkj->nik", poses[:, :3, :3], truth[:, :3, :3])[:, :, 2]
    return np.arccos(np.clip(up[:, 2], -1.0, 1.0))


def test_a_start_far_askew_is_levelled_in_small_steps():
    truth = ahead(80.0, 2.0)
    outcome = driven(truth, [], TILTED)
    tilt = tilt_rad(outcome.online, truth)
    assert tilt[2] == pytest.approx(TILT, rel=1e-3)
    assert tilt[-1] < 0.3 * TILT
    assert {c.cause for c in outcome.corrections} == {Cause.REGISTRATION}
    assert max(c.translation_m for c in outcome.corrections) < 1.1 * LevelSettings().young_step_m


def test_levelling_turns_the_drive_and_does_not_bend_it():
    truth = ahead(80.0, 2.0)
    outcome = driven(truth, [], TILTED)
    assert outcome.pipeline.statistics()["gravity_factors"] >= 2
    assert outcome.ate_m(outcome.final) < 1e-3


def test_answers_after_levelling_doubt_what_those_before_it_have_in_common_with_them():
    truth = ahead(80.0, 2.0)
    outcome = driven(truth, [], TILTED)
    turned = outcome.online[-1][:3, :3] @ truth[-1][:3, :3].T @ truth[0][:3, :3] @ outcome.online[0][:3, :3].T
    sigmas = np.sqrt(np.diag(outcome.covariances[-1]))
    assert np.linalg.norm(se3.so3_log(turned)) > 0.5 * TILT  # by so much the first answer was wrong, and nobody knew
    assert np.linalg.norm(sigmas[:3]) == pytest.approx(np.linalg.norm(se3.so3_log(turned)), rel=0.1)
    assert sigmas[5] > 0.5 * TILT * 80.0


def test_a_map_that_is_level_enough_is_left_alone():
    truth = ahead(80.0, 2.0)
    outcome = driven(truth, [], Odometry(first_tilt_rad=0.006))
    assert outcome.pipeline.statistics()["gravity_factors"] == 0
    assert not outcome.corrections


def test_on_a_long_drive_pitch_drift_is_bounded():
    truth = rounds(600.0, 6.0, radius_m=200.0)
    outcome = driven(truth, [], PITCHING)
    unlevelled_rad = 600.0 * 1e-4
    tilt = tilt_rad(outcome.online, truth)
    bound_rad = LevelSettings().tolerable_rad + 10 * LevelSettings().step_rad  # it goes on while levelling steps
    assert tilt.max() < bound_rad < unlevelled_rad
    assert tilt[-1] < bound_rad
    # without gravity it would climb to 600 m * 0.06 rad / 2 = 18 m
    assert np.abs(outcome.final[:, 2, 3]).max() < 8.0


def turning(mounting_rad: float, tilt_rad: float, sigma_rad: float, turns: float) -> Tilt | None:
    """What 40 keyframes of a tilted map, 20 m out, show a robot that turns and whose IMU is mounted askew."""
    leveller, poses = Leveller(LevelSettings()), []
    tilted = se3.so3_exp(np.array([0.0, tilt_rad, 0.0]))
    for k in range(40):
        heading = se3.so3_exp(np.array([0.0, 0.0, 2 * np.pi * turns * k / 40]))
        poses.append(se3.compose(tilted @ heading, np.array([20.0, 0.0, 0.0])))
        leveller.look(k, se3.so3_exp(np.array([mounting_rad, 0.0, 0.0])) @ heading.T @ DOWN, sigma_rad)
    return leveller.tilt(poses)


def test_the_doubt_of_gravity_itself_keeps_the_map_from_being_turned():
    assert turning(0.0, 0.04, 0.03, turns=1) is None
    tilt = turning(0.0, 0.06, 0.005, turns=1)
    assert tilt is not None
    assert tilt.size_rad == pytest.approx(0.06, rel=0.05)


def test_an_imu_that_is_mounted_askew_is_no_tilt_of_the_map():
    assert turning(0.045, 0.0, 0.002, turns=0.3) is None
    tilt = turning(0.045, 0.08, 0.002, turns=0.3)
    assert tilt is not None
    assert tilt.size_rad == pytest.approx(0.08, rel=0.15)
    # a robot that never turns cannot tell
    assert turning(0.02, 0.0, 0.002, turns=0) is None


def moving_off(shift_rad: float, noise_rad: float = 0.0, stood: bool = True) -> Tilt | None:
    """A level map 20 m out; on the move the edge's gravity is off by so much, though the robot does not turn."""
    leveller, rng = Leveller(LevelSettings()), np.random.default_rng(0)
    if stood:
        leveller.stood(DOWN, np.eye(3))
    poses = [se3.compose(np.eye(3), np.array([20.0, 0.0, 0.0]))] * 40
    for k, noise in enumerate(rng.normal(0, noise_rad, (40, 2))):
        leveller.look(k, se3.so3_exp(np.array([shift_rad + noise[0], noise[1], 0.0])) @ DOWN, 0.002)
    return leveller.tilt(poses)


def test_what_an_imu_with_skew_axes_says_on_the_move_does_not_outweigh_gravity_at_rest():
    assert moving_off(0.08) is None
    assert moving_off(0.08, stood=False) is not None
    load = Leveller(LevelSettings())
    load.stood(DOWN, np.eye(3))
    again = Leveller(LevelSettings())
    again.load(json.loads(json.dumps(load.dump())))
    assert again.dump() == load.dump()


def test_keyframes_that_contradict_each_other_are_believed_less():
    assert moving_off(0.05, stood=False) is not None
    assert moving_off(0.05, noise_rad=0.08, stood=False) is None


def test_a_gravity_factor_levels_the_graph_about_its_origin_and_survives_a_restart():
    graph = PoseGraph(GraphSettings())
    tilted = [
        se3.compose(se3.so3_exp(np.array([0.0, TILT, 0.0])), np.zeros(3))
        @ se3.compose(np.eye(3), np.array([float(k), 0.0, 0.0]))
        for k in range(20)
    ]
    graph.add_first(tilted[0], 0.1)
    graph.optimise(corrected=False)
    for a, b in itertools.pairwise(tilted):
        graph.add_odometry(b, se3.inv(a) @ b, np.diag(np.repeat([1e-4**2, 1e-3**2], 3)))
        graph.optimise(corrected=False)
    before = graph.tilt_sigma_rad(19)
    assert not graph.turned(tilted[19]).any()
    graph.add_gravity(19, DOWN, 0.001)
    graph.optimise(corrected=True)
    assert before == pytest.approx(0.1, rel=0.05)
    assert np.linalg.norm(graph.poses[0][:3, 3]) < 1e-3
    assert tilt_rad(np.array(graph.poses), np.tile(np.eye(4), (20, 1, 1))).max() < 1e-4
    again = PoseGraph.restore(GraphSettings(), list(graph.records), list(graph.poses))
    np.testing.assert_allclose(np.array(again.poses), np.array(graph.poses), atol=1e-6)
    np.testing.assert_allclose(again.turned(again.poses[19]), graph.turned(graph.poses[19]), atol=1e-6)
    # against the first answer, which was askew, the last pose is turned, and 19 m away lifted by as much
    off = se3.log(se3.inv(graph.poses[19]) @ tilted[19])
    assert off[1] == pytest.approx(TILT, rel=0.01)
    np.testing.assert_allclose(graph.turned(graph.poses[19]), np.outer(off, off), atol=1e-3)


def test_a_prior_of_an_older_session_is_as_tight_as_it_was():
    graph = PoseGraph(GraphSettings())
    graph.add_first(np.eye(4), 0.05)
    record = graph.records[0]
    old = json.loads(record.payload)
    del old["tilt"]
    again = PoseGraph.restore(GraphSettings(), [type(record)(0, "prior", json.dumps(old).encode())], [np.eye(4)])
    assert again.tilt_sigma_rad(0) == pytest.approx(1e-4, rel=1e-3)
