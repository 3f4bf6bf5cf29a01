"""When a session's map has a new version, and what the store is told of it."""

from __future__ import annotations

import numpy as np
import pytest

from map_service.growing import Poses
from map_service.happenings import DatumFound, LoopAccepted, MapMove
from map_service.map_versions import MapVersions
from map_service.settings import GraphSettings
from map_service.types import Cause
from splitslam import se3
from tests.map_pipeline.made_walks import along, town, walk

S = GraphSettings()


def shifted(poses: np.ndarray, *, by_m: float = 0.0, by_rad: float = 0.0) -> np.ndarray:
    """The last of (n, 4, 4) moved."""
    moved = poses.copy()
    moved[-1] = moved[-1] @ se3.exp(np.array([0.0, 0.0, by_rad, by_m, 0.0, 0.0]))
    return moved


@pytest.fixture
def poses() -> np.ndarray:
    return np.array([se3.exp(np.array([0.0, 0.0, 0.1 * i, float(i), 0.0, 0.0])) for i in range(5)])


@pytest.fixture
def versions(poses: np.ndarray) -> MapVersions:
    made = MapVersions(S)
    for T in poses:
        made.added(T)
    return made


def test_a_small_move_begins_no_version_but_many_small_ones_do(versions: MapVersions, poses: np.ndarray) -> None:
    moves = []
    for fix in range(1, 11):
        before, after = (shifted(poses, by_m=0.3 * S.version_m * n) for n in (fix - 1, fix))
        if (move := versions.corrected(before, after, Cause.GNSS, fix)) is not None:
            moves.append(move)
    assert [move.first_seq for move in moves] == [4, 8]
    assert versions.number == 3
    assert moves[0].translation_m == pytest.approx(4 * 0.3 * S.version_m)
    np.testing.assert_array_equal(moves[0].T_map_lidar, shifted(poses, by_m=0.3 * S.version_m * 3))


@pytest.mark.parametrize(("share", "begins"), [(0.9, False), (1.1, True)])
def test_a_turn_begins_one_as_a_shift_does(
    versions: MapVersions, poses: np.ndarray, share: float, *, begins: bool
) -> None:
    move = versions.corrected(poses, shifted(poses, by_rad=share * S.version_rad), Cause.LOOP, 7)
    assert (move is not None) == begins
    if move is not None:
        assert move.rotation_rad == pytest.approx(share * S.version_rad, rel=1e-6)
        assert (move.version, move.first_seq, move.cause) == (2, 7, Cause.LOOP)


def test_a_session_goes_on_with_its_number(poses: np.ndarray) -> None:
    versions = MapVersions(S)
    versions.resume(7, Poses(poses))
    move = versions.corrected(poses, shifted(poses, by_m=1.0), Cause.LOOP, 99)
    assert move is not None
    assert move.version == versions.number == 8


def test_a_robot_that_was_lost_and_found_begins_one_though_no_keyframe_moves(
    versions: MapVersions, poses: np.ndarray
) -> None:
    move = versions.relocalised(poses, (3.0, 0.1), 50)
    assert (move.version, move.first_seq, move.cause, move.translation_m) == (2, 50, Cause.RELOCALISE, 3.0)


def test_a_loop_on_a_walk_is_noted_with_what_it_closed_and_the_poses_of_before() -> None:
    corners = [(-40.0, 0.0), (0.0, 0.0), (-18.0, 0.5)]
    done = walk(town(3), along([*corners, (0.0, 0.0)]), np.array([0, 0, 0.002, 0, 0.015, 0]))
    commit = done.pipeline.take_commit()
    loops = [h.what for h in commit.happened if isinstance(h.what, LoopAccepted)]
    moves = [h.what for h in commit.happened if isinstance(h.what, MapMove)]
    assert [(loop.older, loop.newer) for loop in loops] == done.pipeline.graph.loops
    assert moves
    assert [move.version for move in moves] == list(range(2, commit.map_version + 1))
    assert not [h for h in commit.happened if isinstance(h.what, DatumFound)]
    last, now = moves[-1], done.pipeline.graph.poses.matrices
    step_m = np.linalg.norm(now[: len(last.T_map_lidar), :3, 3] - last.T_map_lidar[:, :3, 3], axis=1).max()
    assert step_m > S.version_m
    assert loops[0].translation_m > S.version_m
