"""Old ground used again: when a keyframe stands for it, and what that does to the graph and to memory."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from benchmarks.long_session import AHEAD, LongSession
from benchmarks.town import Counts, Robot, round_and_round, straight_on
from map_service.clouds import Cloud, Clouds, CloudsAwayError
from map_service.graph import PoseGraph
from map_service.ground import MappedGround
from map_service.keyframes import Keyframes
from map_service.loop_gate import Chain
from map_service.pipeline import MapPipeline
from map_service.settings import GraphSettings, GroundSettings
from map_service.surroundings import NEWEST
from splitslam import se3
from splitslam.registration.local_map import LocalMap
from tests import tolerances as bars

SECOND = 1_000_000_000
NOTHING = np.zeros((0, 3), np.float32)
LAP_M, SPEED_MPS = 60.0, 1.5
LAP = 400  # scans


def at(x: float, y: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    return se3.exp(np.array([0, 0, yaw, 0, 0, 0])) + np.array([[0, 0, 0, x], [0, 0, 0, y], [0] * 4, [0] * 4])


def cloud(seed: int = 0, points: int = 200, reach_m: float = 90.0) -> Cloud:
    rng = np.random.default_rng(seed)
    corners, surfs = (rng.uniform(-reach_m, reach_m, (points, 3)).astype(np.float32) for _ in range(2))
    return Cloud(corners, surfs, np.zeros(points, np.uint8), np.ones(points, np.uint8))


def there_and_back(loops: list[tuple[int, int]]) -> tuple[Keyframes, Chain]:
    """60 m out, by day; 60 m back on the same line, a keyframe each metre and second."""
    keyframes = Keyframes()
    for k in range(121):
        keyframes.append(
            k + 1, k * SECOND, at(float(min(k, 120 - k))), Cloud(NOTHING, NOTHING, *[np.zeros(0, np.uint8)] * 2)
        )
    return keyframes, Chain([keyframes.T_local(k) for k in range(121)], keyframes.way_m(), loops, keyframes.branches)


def covering(T: np.ndarray, loops: list[tuple[int, int]], reference: int = 120, seconds: int = 121) -> int | None:
    ground = MappedGround(GroundSettings())
    ground.reference = reference
    return ground.covering(T, seconds * SECOND, *there_and_back(loops))


def test_old_ground_is_used_again_once_a_loop_ties_it_to_the_robot():
    assert covering(at(0.2), loops=[]) is None
    assert covering(at(0.2), loops=[(0, 120)]) == 0
    assert covering(at(0.8), loops=[(0, 120)]) == 1


@pytest.mark.parametrize(
    ("T", "seconds"),
    [
        (at(-1.0), 121),  # beyond the last keyframe
        (at(0.2, y=1.0), 121),  # beside the way
        (at(0.2, yaw=0.6), 121),  # another heading
        (at(10.0), 121),  # its youngest keyframe is of this visit, the old one is 110 s of way from a loop
        (at(0.2), 29),  # nothing is old yet
    ],
)
def test_ground_that_was_not_seen_from_here_is_new(T: np.ndarray, seconds: int):
    assert covering(T, loops=[(0, 120)] if seconds == 121 and T[0, 3] < 5 else [], seconds=seconds) is None


def test_a_way_through_the_graph_takes_branches_and_does_not_jump_from_stretch_to_stretch():
    keyframes, nothing = Keyframes(), [np.zeros(0, np.uint8)] * 2
    for k, (x, y, follows) in enumerate([(0, 0, None), (10, 0, None), (20, 0, None), (0, 5, 0), (0, 15, None)]):
        keyframes.append(k + 1, k * SECOND, at(float(x), float(y)), Cloud(NOTHING, NOTHING, *nothing), follows)
    chain = Chain([keyframes.T_local(k) for k in range(5)], keyframes.way_m(), [], keyframes.branches)
    assert keyframes.branches == [(3, 0, 5.0)]
    assert chain.tied_m(4, 3) == pytest.approx(10.0)
    assert chain.tied_m(4, 2) == pytest.approx(10.0 + 5.0 + 20.0)
    assert chain.tied_m(2, 3) == pytest.approx(25.0)
    assert list(keyframes.around(3, 3, 3)) == [3, 4]
    assert list(keyframes.around(1, 3, 3)) == [0, 1, 2]


def test_a_keyframe_that_follows_an_old_one_hangs_on_it_in_the_graph_and_after_a_restart():
    graph, sure = PoseGraph(GraphSettings()), np.eye(6) * 1e-6
    graph.add_first(at(0.0))
    for x in (1.0, 2.0, 3.0):
        graph.add_odometry(at(x), at(1.0), sure)
    graph.add_odometry(at(0.0, 2.0), at(0.0, 1.0), sure, follows=0)  # the guess is a metre off
    graph.optimise(corrected=True)
    again = PoseGraph.restore(GraphSettings(), list(graph.records), list(graph.poses))
    for one in (graph, again):
        np.testing.assert_allclose(one.poses[4], at(0.0, 1.0), atol=1e-6)
        assert one.follows == {4: 0}


def test_a_cloud_takes_a_little_over_half_and_is_what_the_store_gives_back():
    one = cloud()
    again = Cloud.decoded(one.encoded())
    np.testing.assert_array_equal(one.corners_lidar, again.corners_lidar)
    np.testing.assert_array_equal(one.surfs_lidar, again.surfs_lidar)
    assert one.nbytes == 400 * 7
    far = cloud(reach_m=400.0)  # beyond what 16 bits hold
    np.testing.assert_array_equal(far.surfs_lidar, Cloud.decoded(far.encoded()).surfs_lidar)
    assert np.abs(far.surfs_lidar).max() > 300.0


def test_clouds_that_are_let_go_come_back_from_the_store():
    made = [cloud(i) for i in range(5)]
    asked: list[list[int]] = []

    def fetch(indices: Sequence[int]) -> dict[int, bytes]:
        asked.append(list(indices))
        return {i: made[i].encoded() for i in indices}

    clouds = Clouds()
    for one in made:
        clouds.append(one)
    clouds.keep({1}, below=3, fetch=fetch)  # 3 and 4 are not in the store yet
    assert clouds.loaded == 3
    for got, one in zip(clouds.get(range(5)), made, strict=True):
        np.testing.assert_array_equal(got.surfs_lidar, one.surfs_lidar)
    assert asked == [[0, 2]]


# --- whole sessions --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def circling(tmp_path_factory: pytest.TempPathFactory):
    """Three laps of 60 m, the third after a restart of the pipeline from the store."""
    town, way = round_and_round(LAP_M, SPEED_MPS)
    robot = Robot(town, way, counts=Counts((100, 500), (200, 1800)))
    session = LongSession(robot, f"sqlite:///{tmp_path_factory.mktemp('circling') / 'map.db'}", way)
    samples = [session.play(LAP) for _ in range(2)]
    before = session.pipeline
    session.reopen()
    samples.append(session.play(LAP))
    yield samples, before, session
    session.close()


def test_a_session_on_the_same_ground_grows_with_the_ground_and_not_with_time(circling):
    (first, second, third), _, session = circling
    assert first.keyframes > 50
    assert second.loops > 0
    assert third.keyframes <= bars.GROWTH_BY_TIME * second.keyframes
    assert third.rest_mb <= bars.GROWTH_BY_TIME * second.rest_mb
    assert max(sample.off_m for sample in (first, second, third)) < bars.SAME_GROUND_OFF_M
    assert len(session.pipeline.frames) <= 2 * AHEAD
    assert session.pipeline.graph.records == []


def test_a_restart_on_old_ground_goes_on_from_the_same_keyframe(circling):
    _, before, session = circling
    assert before.ground.reference < len(before.keyframes) - 1
    assert session.began_at == before.ground.reference


def test_over_new_ground_the_local_map_and_the_clouds_in_memory_go_along_with_the_robot(tmp_path: Path):
    town, way = straight_on(8.0)
    session = LongSession(Robot(town, way), f"sqlite:///{tmp_path / 'map.db'}", way)
    sample = session.play(400)
    pipeline = session.pipeline
    s = pipeline.settings.tracker.local_map
    here_m = pipeline.tracker.state.T_local_lidar[:3, 3]  # type: ignore[union-attr]
    inserted = pipeline.tracker.local_map.keyframes
    assert sample.keyframes > 1.5 * len(inserted) > 100
    assert inserted.issuperset(pipeline.keyframes.within(here_m, s.radius_m - 2 * s.step_m))
    assert inserted.issubset(pipeline.keyframes.within(here_m, s.radius_m + s.rebuild_distance_m + 4 * s.step_m))
    assert sample.clouds_loaded < 0.85 * sample.keyframes
    assert sample.off_m < bars.NEW_GROUND_OFF_M
    assert voxels(pipeline.tracker.local_map) == voxels(filled_anew(pipeline))
    away(session)
    session.close()


def filled_anew(pipeline: MapPipeline) -> LocalMap:
    """A local map of the same keyframes."""
    fresh = LocalMap(pipeline.settings.tracker.local_map)
    for i in sorted(pipeline.tracker.local_map.keyframes):
        keyframe = pipeline.keyframes[i]
        fresh.insert(i, keyframe.T_local_lidar, keyframe.cloud.corners_lidar, keyframe.cloud.surfs_lidar)
    return fresh


def voxels(local_map: LocalMap) -> list[dict[int, int]]:
    """Points by voxel, corners and surfs."""
    return [
        {int(k): round(float(m[0])) for k, m in zip(v.keys, v.moments, strict=True) if k != -1}
        for v in (local_map.corners, local_map.surfs)
    ]


def away(session: LongSession) -> None:
    """The store goes while old clouds are needed: the map that is there goes on, and so does the session."""
    pipeline = session.pipeline

    def nothing(_: Sequence[int]) -> dict[int, bytes]:
        raise CloudsAwayError("not now")

    inserted = set(pipeline.tracker.local_map.keyframes)
    pipeline.keyframes.clouds.keep(set(), below=len(pipeline.keyframes) - NEWEST, fetch=nothing)
    assert pipeline.keyframes.clouds.loaded == NEWEST
    pipeline.map_frame.renew(pipeline.tracker, pipeline.keyframes, pipeline.graph.poses)
    assert pipeline.tracker.local_map.keyframes == inserted
    assert session.play(1).off_m < bars.NEW_GROUND_OFF_M
