"""The pose graph as gtsam reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest

from splitslam import se3
from splitslam.export.g2o import datum_id, write_g2o
from splitslam.maps import AntennaFix, Between, MapGraph
from tests import tolerances

ORIGIN = (35.5, 139.6, 30.0)
T_ENU_MAP = se3.exp(np.array([0.01, 0.0, 1.1, 40.0, -8.0, 2.0]))
ANTENNA = np.array([0.2, -0.1, 0.6])


def covariance(seed: int) -> np.ndarray:
    A = np.random.default_rng(seed).normal(size=(6, 6)) * np.repeat([1e-3, 1e-2], 3)[:, None]
    return A @ A.T + np.diag(np.repeat([1e-7, 1e-5], 3))


def a_loop() -> MapGraph:
    """Once round a square, odometry, a loop and fixes that all agree."""
    poses = [np.eye(4)]
    for k in range(11):
        poses.append(poses[-1] @ se3.exp(np.array([0.01, -0.02, np.pi / 2 * (k % 3 == 2), 2.0, 0.1, 0.05])))
    T = np.array(poses)
    betweens = [Between("odometry", i, i + 1, se3.inv(T[i]) @ T[i + 1], covariance(i)) for i in range(11)]
    betweens.append(Between("loop", 0, 11, se3.inv(T[0]) @ T[11], covariance(99), robust=True))
    fixes = []
    for i in range(0, 12, 2):
        enu = (T_ENU_MAP @ T[i] @ np.append(ANTENNA, 1.0))[:3]
        fixes.append(AntennaFix(i, ANTENNA, enu, np.array([0.5, 0.4, 1.0]), 0))
    return MapGraph(T, np.arange(12) * 10**9, betweens, fixes, {0: T_ENU_MAP}, ORIGIN, {"gravity": 3})


def test_gtsam_reads_every_vertex_and_edge_with_its_information(tmp_path: Path) -> None:
    made = a_loop()
    written = write_g2o(tmp_path / "graph.g2o", made)
    assert (written.vertices, written.edges, written.left_out) == (13, 12 + 6, {"gravity": 3})
    graph, values = gtsam.readG2o(str(tmp_path / "graph.g2o"), True)
    for i, T in enumerate(made.T_map_lidar):
        np.testing.assert_allclose(values.atPose3(i).matrix(), T, atol=tolerances.G2O_READ)
    np.testing.assert_allclose(values.atPose3(datum_id(made, 0)).matrix(), se3.inv(T_ENU_MAP), atol=tolerances.G2O_READ)
    assert graph.size() == 18
    assert graph.error(values) == pytest.approx(0.0, abs=tolerances.G2O_READ)
    for k, between in enumerate(made.betweens):
        factor: Any = graph.at(k)
        assert list(factor.keys()) == [between.older, between.newer]
        np.testing.assert_allclose(factor.measured().matrix(), between.T_older_newer, atol=tolerances.G2O_READ)
        information = factor.noiseModel().information()
        expected = np.linalg.inv(between.covariance)
        np.testing.assert_allclose(information, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_a_disturbed_graph_comes_back_to_where_the_keyframes_are(tmp_path: Path) -> None:
    made = a_loop()
    write_g2o(tmp_path / "graph.g2o", made)
    graph, values = gtsam.readG2o(str(tmp_path / "graph.g2o"), True)
    graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(made.T_map_lidar[0]), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    rng, moved = np.random.default_rng(2), gtsam.Values()
    for key in list(values.keys()):
        moved.insert(key, values.atPose3(key).retract(rng.normal(0.0, 0.05, 6)))
    found = gtsam.LevenbergMarquardtOptimizer(graph, moved).optimize()
    for i, T in enumerate(made.T_map_lidar):
        np.testing.assert_allclose(found.atPose3(i).matrix(), T, atol=tolerances.G2O_BACK_M)


def test_a_fix_that_disagrees_weighs_as_its_sigmas_say(tmp_path: Path) -> None:
    made = a_loop()
    east_m = np.array([1.5, 0.0, 0.0])
    fix = made.fixes[2]
    made.fixes[2] = AntennaFix(fix.keyframe, fix.antenna_keyframe, fix.enu_m + east_m, fix.sigmas_m, 0)
    write_g2o(tmp_path / "graph.g2o", made)
    graph, values = gtsam.readG2o(str(tmp_path / "graph.g2o"), True)
    assert graph.error(values) == pytest.approx(0.5 * (1.5 / 0.5) ** 2, rel=1e-3)
