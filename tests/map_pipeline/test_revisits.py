"""The whole pipeline on walks through made places, whose odometry drifts far more than any that we have seen."""

from __future__ import annotations

import json

import numpy as np
import pytest

from map_service import persistence
from tests.map_pipeline.made_walks import along, corridors, town, walk

ROUND = [(-40, 0), (40, 0), (40, 40), (-40, 40), (-40, -40), (0, -40), (0, 0)]
BENT = np.array([0, 0, 0.0025, 0.04, 0.02, 0])  # each metre: 2.5 mrad to the left, 4 cm too long, 2 cm aside
USUAL = np.array([0, 0, 2e-4, 0.004, 0.002, 0])


@pytest.mark.parametrize("last", [(30, 0.5), (-30, 0.5)], ids=["the same way", "the other way round"])
def test_a_revisit_is_found_after_15_m_of_drift(last: tuple[float, float]):
    done = walk(town(3), along([*ROUND, last]), BENT)
    graph = done.pipeline.graph
    assert done.pipeline.stats.largest_correction_m > 15.0
    assert len(graph.loops) >= 8
    assert max(done.loop_errors_m()) < 4.0
    # where the way is the same again, the map is the same again, to the odometry's bend over a few metres
    for older, newer in graph.loops:
        said = np.linalg.inv(graph.poses[older]) @ graph.poses[newer]
        true = np.linalg.inv(done.truth[older]) @ done.truth[newer]
        assert np.linalg.norm(said[:3, 3] - true[:3, 3]) < 0.3


def test_no_loop_is_made_between_corridors_that_are_alike():
    """Three corridors of seven identical modules side by side, walked once each, to and fro."""
    length_m = 42.0
    corners = [(-1, 0), (length_m + 1, 0), (length_m + 1, 6), (-1, 6), (-1, 12), (length_m + 1, 12)]
    # places are looked for as if the graph's guess were never good enough
    done = walk(corridors((0.0, 6.0, 12.0), length_m), along(corners), USUAL, loops={"near_drift_m": 0.0})
    fitted = [result for _, result, _ in done.verifier.done if result.accepted or result.reason == "ambiguous"]
    assert len(fitted) > 10  # there was something to be taken in by
    assert done.pipeline.graph.loops == []


def test_a_corridor_among_others_that_are_alike_is_known_again_when_it_is_walked_again():
    length_m = 42.0
    corners = [(-1, 0), (length_m + 1, 0), (length_m + 1, 6), (-1, 6), (-1, 0), (length_m + 1, 0)]
    done = walk(corridors((0.0, 6.0), length_m), along(corners), USUAL)
    assert done.pipeline.graph.loops
    assert max(done.loop_errors_m()) < 1.0
    assert done.errors_m()[-1] < 0.7 * np.linalg.norm(USUAL[3:]) * done.pipeline.keyframes.way_m()[-1]


def test_what_waits_for_support_survives_a_restart():
    corners = [(-40.0, 0.0), (0.0, 0.0), (-18.0, 0.5)]
    done = walk(town(3), along(corners), np.array([0, 0, 0.004, 0, 0.03, 0]), finish=False)
    closer = done.pipeline.closer
    assert closer is not None
    assert closer.gate.waiting
    state = json.loads(persistence.dump(done.pipeline))["closer"]
    fresh = walk(town(3), along(corners)[:1], BENT, finish=False).pipeline.closer
    assert fresh is not None
    places = [closer.places.packed(i) for i in range(len(closer.places))]
    fresh.load(state, places[:-2], done.pipeline.keyframes, done.pipeline.graph.poses)  # two must be described again
    assert [fresh.places.packed(i) for i in range(len(places))] == places
    assert json.loads(json.dumps(fresh.dump())) == state
