from __future__ import annotations

import itertools
import json

import gtsam
import numpy as np

from map_service.gnss import GnssMeasurement
from map_service.gnss_consensus import PlacedFix
from map_service.gnss_datum import Weight
from map_service.graph import PoseGraph, _gnss_error
from map_service.settings import GraphSettings
from map_service.types import FactorRecord
from splitslam import se3

COVARIANCE = np.diag(np.repeat([1e-3**2, 0.01**2], 3))


def square_drive(count: int = 40, side: int = 10) -> list[np.ndarray]:
    """Poses along a square of 10 m sides, 1 m apart, back to the start."""
    poses = [np.eye(4)]
    for k in range(1, count + 1):
        turn = np.array([0, 0, np.pi / 2 if k % side == 0 else 0.0])
        poses.append(poses[-1] @ se3.compose(se3.so3_exp(turn), np.array([1.0, 0, 0])))
    return poses


def driven(bias: np.ndarray) -> tuple[PoseGraph, list[np.ndarray]]:
    """A graph whose odometry drifts by `bias` (6,) each metre, and the truth."""
    truth = square_drive()
    graph = PoseGraph(GraphSettings())
    graph.add_first(truth[0])
    graph.optimise(corrected=False)
    T = truth[0]
    for a, b in itertools.pairwise(truth):
        motion = se3.inv(a) @ b @ se3.exp(bias)
        T = T @ motion
        graph.add_odometry(T, motion, COVARIANCE)
        graph.optimise(corrected=False)
    return graph, truth


DRIFT = np.array([0, 0, 0.002, 0.01, 0, 0])


def test_a_loop_closes_the_gap_and_bends_the_whole_drive():
    graph, truth = driven(DRIFT)
    gap_m = np.linalg.norm(graph.poses[-1][:3, 3] - truth[-1][:3, 3])
    middle_m = np.linalg.norm(graph.poses[20][:3, 3] - truth[20][:3, 3])
    graph.add_loop(0, 40, se3.inv(truth[0]) @ truth[40], COVARIANCE, robust_sigmas=80.0)
    graph.optimise(corrected=True)
    assert gap_m > 0.3
    assert np.linalg.norm(graph.poses[-1][:3, 3] - truth[-1][:3, 3]) < 0.05
    assert np.linalg.norm(graph.poses[20][:3, 3] - truth[20][:3, 3]) < middle_m


def test_a_false_loop_is_outvoted_by_the_robust_kernel():
    graph, truth = driven(np.zeros(6))
    graph.add_loop(0, 40, se3.compose(np.eye(3), np.array([8.0, 3.0, 0.0])), COVARIANCE)
    graph.optimise(corrected=True)
    assert np.linalg.norm(graph.poses[-1][:3, 3] - truth[-1][:3, 3]) < 0.1


def measurement(keyframe: int, enu_m: list[float], datum: int) -> GnssMeasurement:
    antenna = np.array([0.1, 0, 0.3])
    fix = PlacedFix(keyframe, keyframe, antenna, antenna, np.array(enu_m), np.ones(3), 0.0, 0.0)
    return GnssMeasurement(fix, Weight(np.array([1.0, 1.0, 2.0]), np.ones(3), 3.0), datum, np.eye(4))


def test_a_loop_corrects_only_what_its_covariance_says_it_observes():
    graph, _ = driven(np.zeros(6))
    open_along_x = COVARIANCE + np.diag([0, 0, 0, 100.0, 0, 0])
    before = graph.poses[-1].copy()  # looks along x again, at the start
    graph.add_loop(0, 40, before @ se3.compose(np.eye(3), np.array([0.2, 0.2, 0.0])), open_along_x, robust_sigmas=80.0)
    graph.optimise(corrected=True)
    moved = graph.poses[-1][:3, 3] - before[:3, 3]
    assert abs(moved[0]) < 0.02
    assert moved[1] > 0.1


def test_a_loop_as_the_first_release_stored_it_is_read():
    graph, truth = driven(DRIFT)
    motion = (se3.inv(truth[0]) @ truth[40])[:3].reshape(-1).tolist()
    payload = {"v": 1, "older": 0, "newer": 40, "motion": motion, "sigmas": [1e-3, 0.01], "robust": 80.0}
    old = FactorRecord(len(graph.records), "loop", json.dumps(payload).encode())
    again = PoseGraph.restore(GraphSettings(), [*graph.records, old], list(graph.poses))
    graph.add_loop(0, 40, se3.inv(truth[0]) @ truth[40], COVARIANCE, robust_sigmas=80.0)
    graph.optimise(corrected=True)
    assert again.loops == [(0, 40)]
    assert np.linalg.norm(again.poses[-1][:3, 3] - graph.poses[-1][:3, 3]) < 2e-3


def test_a_restored_graph_is_the_same_graph():
    graph, truth = driven(DRIFT)
    graph.add_loop(0, 40, se3.inv(truth[0]) @ truth[40], COVARIANCE)
    graph.add_gnss(measurement(5, [5.0, 0.1, 0.3], datum=0))
    graph.add_gnss(measurement(15, [10.0, 5.1, 0.3], datum=0))
    graph.add_gnss(measurement(20, [30.0, 10.1, 0.3], datum=1))
    graph.add_gravity(30, np.array([0.01, 0.0, -1.0]), 0.05)
    graph.optimise(corrected=True)
    again = PoseGraph.restore(GraphSettings(), list(graph.records), list(graph.poses))
    assert [r.payload for r in again.records] == [r.payload for r in graph.records]
    assert sorted(again.data) == sorted(graph.data) == [0, 1]
    for a, b in zip(graph.poses, again.poses, strict=True):
        assert np.linalg.norm((se3.inv(a) @ b)[:3, 3]) < 2e-3
    # and it goes on
    T = again.poses[-1]
    again.add_odometry(T, np.eye(4), COVARIANCE)
    again.optimise(corrected=False)
    assert len(again.poses) == len(graph.poses) + 1


def test_the_gnss_factor_s_jacobians_are_those_of_its_error():
    rng = np.random.default_rng(3)
    E, T = se3.exp(rng.normal(size=6)), se3.exp(rng.normal(size=6))
    error = _gnss_error(np.array([0.3, -0.2, 0.9]), np.array([4.0, 5.0, 6.0]))
    factor = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(3), [gtsam.symbol("z", 0), gtsam.symbol("x", 0)], error)

    def at(a: np.ndarray, b: np.ndarray, jacobians=None) -> np.ndarray:
        values = gtsam.Values()
        values.insert(gtsam.symbol("z", 0), gtsam.Pose3(E @ se3.exp(a)))
        values.insert(gtsam.symbol("x", 0), gtsam.Pose3(T @ se3.exp(b)))
        return error(factor, values, jacobians)

    jacobians: list = [None, None]
    zero, step = np.zeros(6), 1e-6
    at(zero, zero, jacobians)
    for which in (0, 1):
        numeric = np.stack(
            [
                (
                    at(*((step * e, zero) if which == 0 else (zero, step * e)))
                    - at(*((-step * e, zero) if which == 0 else (zero, -step * e)))
                )
                / (2 * step)
                for e in np.eye(6)
            ],
            axis=1,
        )
        np.testing.assert_allclose(jacobians[which], numeric, atol=1e-7)
