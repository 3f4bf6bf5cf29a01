from __future__ import annotations

import itertools

import gtsam
import numpy as np
import pytest

from map_service.gnss import GnssGate
from map_service.graph import ENU_KEY, PoseGraph, _gnss_error
from map_service.settings import GnssSettings, GraphSettings
from splitslam import se3
from splitslam.scan import GnssFix

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
    graph.add_loop(0, 40, se3.inv(truth[0]) @ truth[40], (1e-3, 0.01), robust_sigmas=80.0)
    graph.optimise(corrected=True)
    assert gap_m > 0.3
    assert np.linalg.norm(graph.poses[-1][:3, 3] - truth[-1][:3, 3]) < 0.05
    assert np.linalg.norm(graph.poses[20][:3, 3] - truth[20][:3, 3]) < middle_m


def test_a_false_loop_is_outvoted_by_the_robust_kernel():
    graph, truth = driven(np.zeros(6))
    graph.add_loop(0, 40, se3.compose(np.eye(3), np.array([8.0, 3.0, 0.0])), (1e-3, 0.01))
    graph.optimise(corrected=True)
    assert np.linalg.norm(graph.poses[-1][:3, 3] - truth[-1][:3, 3]) < 0.1


def test_a_restored_graph_is_the_same_graph():
    graph, truth = driven(DRIFT)
    graph.add_loop(0, 40, se3.inv(truth[0]) @ truth[40], (1e-3, 0.01))
    graph.add_gnss(5, np.array([0.1, 0, 0.3]), np.array([5.0, 0.1, 0.3]), np.array([1.0, 1.0, 2.0]), np.eye(4))
    graph.add_gnss(15, np.array([0.1, 0, 0.3]), np.array([10.0, 5.1, 0.3]), np.array([1.0, 1.0, 2.0]), np.eye(4))
    graph.optimise(corrected=True)
    again = PoseGraph.restore(GraphSettings(), list(graph.records), list(graph.poses))
    assert [r.payload for r in again.records] == [r.payload for r in graph.records]
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
    factor = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(3), [ENU_KEY, gtsam.symbol("x", 0)], error)

    def at(a: np.ndarray, b: np.ndarray, jacobians=None) -> np.ndarray:
        values = gtsam.Values()
        values.insert(ENU_KEY, gtsam.Pose3(E @ se3.exp(a)))
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


METRES_PER_DEGREE = 111_319.5


def fix_at(enu: np.ndarray, stamp_ns: int = 0, sigma_m: float = 0.5, status: int = 0) -> GnssFix:
    """Near the equator a degree is as long as a degree: exact enough for metres."""
    return GnssFix(
        stamp_ns, enu[1] / 110_574.0, 10.0 + enu[0] / METRES_PER_DEGREE, 100.0 + enu[2], np.eye(3) * sigma_m**2, status
    )


def test_gnss_straightens_a_bent_drive_and_finds_the_heading_of_the_map():
    graph, truth = driven(np.array([0, 0, 0.003, 0.0, 0, 0]))  # three times what the odometry claims
    yaw = 2.2
    T_enu_map = se3.compose(se3.so3_exp(np.array([0, 0, yaw])), np.zeros(3))
    bent_m = np.linalg.norm(graph.poses[-1][:3, 3] - truth[-1][:3, 3])
    gate = GnssGate(GnssSettings(correlation=1.0, spacing_m=1.0, drift_share=0.3, floor_m=0.2))
    rng = np.random.default_rng(4)
    used = 0
    for i, T in enumerate(truth):
        enu = (T_enu_map @ T)[:3, 3] + rng.normal(0, 0.1, 3)
        measurement = gate.offer(fix_at(enu, i, 0.1), graph.poses[i][:3, 3], graph.T_enu_map)
        if measurement is not None:
            graph.add_gnss(i, np.zeros(3), measurement.enu_m, measurement.sigmas_m, measurement.T_enu_map)
            graph.optimise(corrected=True)
            used += 1
    assert used > 15
    assert graph.T_enu_map is not None
    found = np.arctan2(graph.T_enu_map[1, 0], graph.T_enu_map[0, 0])
    assert bent_m > 0.5
    assert found == pytest.approx(yaw, abs=0.1)
    aligned = [(se3.inv(T_enu_map) @ graph.T_enu_map @ T)[:3, 3] for T in graph.poses]
    errors = [np.linalg.norm(a - t[:3, 3]) for a, t in zip(aligned, truth, strict=True)]
    assert np.mean(errors) < 0.4 * bent_m


def test_bad_fixes_are_counted_by_reason_and_none_becomes_a_factor():
    gate = GnssGate(GnssSettings())
    here = np.zeros(3)
    assert gate.offer(fix_at(here, status=-1), here, None) is None
    assert gate.offer(fix_at(here, sigma_m=20.0), here, None) is None
    assert gate.offer(GnssFix(0, float("nan"), 0.0, 0.0, None), here, None) is None
    assert gate.rejected == {"no_fix": 2, "covariance": 1}


def test_a_15_m_jump_is_gated_and_the_fixes_after_it_are_used_again():
    gate = GnssGate(GnssSettings(spacing_m=1.0))
    used, jumped = [], []
    for i in range(60):
        position = np.array([float(i), 0.0, 0.0])
        jump = np.array([0.0, 15.0, 0.0]) if 30 <= i < 40 else np.zeros(3)
        if gate.offer(fix_at(position + jump, i), position, gate.T_enu_map) is not None:
            (jumped if jump.any() else used).append(i)
    assert not jumped
    assert max(used) == 59
    assert gate.rejected["gated"] == 10
