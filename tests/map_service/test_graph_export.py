"""The stored graph for others."""

from __future__ import annotations

import numpy as np
import pytest

from map_service.catalog import StoredGraph
from map_service.graph_export import map_graph
from map_service.graph_messages import graph_to_wire
from map_service.types import FactorRecord
from splitslam import se3
from splitslam.errors import DataError
from splitslam.export.server_source import graph_from_wire
from splitslam.maps import MapGraph
from tests import tolerances
from tests.map_pipeline.made_drives import DATUM, Odometry, Outcome, Receiver, driven, fixes, rounds


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    truth = rounds(120.0, 1.4)
    return driven(truth, fixes(truth, Receiver(rate_hz=1.0)), Odometry(drift=(0, 0, 2e-5, 0.002, 0, 0.001)))


@pytest.fixture(scope="module")
def stored(outcome: Outcome) -> StoredGraph:
    """As the store has it after the last commit."""
    commit = outcome.pipeline.take_commit()
    poses = dict(commit.keyframe_poses)
    keyframes = [(k.index, k.stamp_ns, poses.get(k.index, k.T_map_lidar)) for k in commit.keyframes]
    return StoredGraph(keyframes, commit.factors, commit.tracker)


def test_the_map_lies_on_earth_where_the_graph_in_memory_has_it(outcome: Outcome, stored: StoredGraph) -> None:
    found, expected = map_graph(stored).georeference, outcome.pipeline.graph.T_enu_map
    assert found is not None
    assert expected is not None
    off = se3.inv(expected) @ found.T_enu_map
    assert np.linalg.norm(off[:3, 3]) < tolerances.EXPORT_ENU_M
    assert se3.angle(off) < tolerances.EXPORT_ENU_RAD
    # the receiver's first fix is the origin of enu: the made drive begins 126 m from its datum
    assert abs(found.latitude_deg - DATUM[0]) < 0.002
    assert abs(found.longitude_deg - DATUM[1]) < 0.002


def test_every_factor_is_there_or_counted(outcome: Outcome, stored: StoredGraph) -> None:
    graph = map_graph(stored)
    assert len(graph.T_map_lidar) == len(outcome.pipeline.graph.poses)
    assert len(graph.fixes) == outcome.pipeline.stats.gnss_factors > 10
    assert len(graph.betweens) + len(graph.fixes) + sum(graph.others.values()) == len(stored.factors)
    assert graph.others["prior"] == 1
    for between in graph.betweens:
        np.linalg.cholesky(between.covariance)


def test_a_graph_goes_over_the_wire_as_it_is(stored: StoredGraph) -> None:
    graph = map_graph(stored)
    parts = list(graph_to_wire(graph))
    assert len(parts) >= 4
    found = graph_from_wire(parts)
    assert found.origin == graph.origin
    assert found.others == graph.others
    np.testing.assert_array_equal(found.stamps_ns, graph.stamps_ns)
    np.testing.assert_allclose(found.T_map_lidar, graph.T_map_lidar, atol=tolerances.SE3_ROUND_TRIP_M)
    np.testing.assert_allclose(found.T_enu_map[0], graph.T_enu_map[0], atol=1e-7)
    for a, b in zip(found.betweens, graph.betweens, strict=True):
        assert (a.kind, a.older, a.newer, a.robust) == (b.kind, b.older, b.newer, b.robust)
        np.testing.assert_array_equal(a.covariance, b.covariance)
    for a, b in zip(found.fixes, graph.fixes, strict=True):
        assert (a.keyframe, a.datum) == (b.keyframe, b.datum)
        np.testing.assert_array_equal([a.antenna_keyframe, a.enu_m, a.sigmas_m],
                                      [b.antenna_keyframe, b.enu_m, b.sigmas_m])  # fmt: skip


def test_a_graph_without_gnss_lies_nowhere() -> None:
    graph = map_graph(StoredGraph([(0, 5, np.eye(4))], [FactorRecord(0, "prior", b'{"v": 1}')], b""))
    assert graph.georeference is None
    assert isinstance(graph, MapGraph)
    assert graph_from_wire(list(graph_to_wire(graph))).georeference is None


@pytest.mark.parametrize(
    ("keyframes", "factors"),
    [
        ([(1, 5, np.eye(4))], []),
        ([(0, 5, np.eye(4))], [FactorRecord(0, "odometry", b"not json")]),
        ([(0, 5, np.eye(4))], [FactorRecord(0, "loop", b'{"older": 0}')]),
        ([(0, 5, np.eye(4))], [FactorRecord(0, "gnss", b'{"keyframe": 7}')]),
    ],
    ids=["a keyframe is missing", "not JSON", "a key is missing", "a fix of nothing"],
)
def test_rows_that_do_not_hold_together_are_a_data_error(keyframes: list, factors: list) -> None:
    with pytest.raises(DataError):
        map_graph(StoredGraph(keyframes, factors, b""))
