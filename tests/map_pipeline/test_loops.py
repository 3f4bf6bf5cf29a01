from __future__ import annotations

import hashlib
import json
import platform
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest

from map_service.closing import LoopCloser
from map_service.keyframes import Cloud, Keyframes
from map_service.loop_fit import CloudPair
from map_service.loop_gate import Chain
from map_service.loop_search import search
from map_service.loops import LoopJob, LoopResult, near_candidate, verify
from map_service.places import PlaceIndex
from map_service.settings import LoopFitSettings, LoopSettings
from splitslam import se3
from tests.map_pipeline.naive import room

SECOND = 1_000_000_000
UP = np.array([0.0, 0.0, 1.0])
NEEDS_MATCHER = pytest.mark.skipif(platform.machine() != "x86_64", reason="kiss-matcher has no wheels but for x86_64")


def test_a_near_candidate_is_near_and_old():
    positions = np.array([[0.0, 0, 0], [5, 0, 0], [20, 0, 0], [5, 1, 0]])
    stamps = np.array([0, 10, 40, 60]) * SECOND
    s = LoopSettings(radius_m=10, min_age_s=30)
    assert near_candidate(positions, stamps, 3, -1, s) == 1  # the nearest of two
    assert near_candidate(positions, stamps, 2, -1, s) is None  # too far
    assert near_candidate(positions, stamps[:2], 1, -1, s) is None  # too young
    assert near_candidate(positions, stamps, 3, 1, s) is None  # one was tried a metre ago


def furnished(rng: np.random.Generator, count: int) -> np.ndarray:
    """A room with a partition and furniture, which no turn or shift lays on itself, (N, 3)."""
    surfs, poles = room(rng, count, 0.02)
    u = rng.uniform(-0.5, 0.5, (count // 3, 3))
    side = rng.integers(0, 2, count // 3)
    u[np.arange(count // 3), side] = np.sign(u[np.arange(count // 3), side]) * 0.5
    which = rng.integers(0, 4, count // 3)
    middles = np.array([[-5, -3, 0.8], [3.5, 3.2, 0.5], [4.5, -3.0, 1.2], [-1.5, 3.4, 1.0]])
    sizes = np.array([[1.0, 1.5, 1.6], [2.5, 0.8, 1.0], [0.7, 1.2, 2.4], [1.2, 1.0, 2.0]])
    furniture = middles[which] + u * sizes[which]
    partition = np.column_stack([rng.uniform([1.0, -4.0, 0.0], [1.1, 1.5, 3.0], (count // 4, 3))])
    return np.concatenate([surfs, poles, furniture, partition])


def job(T_true: np.ndarray, T_guess: np.ndarray, *, by_looks: bool = False, other_place: bool = False) -> LoopJob:
    rng = np.random.default_rng(5)
    target, source = furnished(rng, 20_000), furnished(rng, 8_000)
    if other_place:
        source = np.column_stack([rng.uniform(-8, 8, (8000, 2)), rng.uniform(0, 4, 8000)])
    T = se3.inv(T_true)
    moved = (source @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
    return LoopJob(3, 90, target.astype(np.float32), moved, T_guess, UP, T_true[2, :3], by_looks, LoopSettings())


@pytest.mark.parametrize("drift", [[0, 0, 0.02, 0.3, -0.2, 0.1], [0.01, 0, -0.05, -0.5, 0.6, 0]])
def test_a_true_revisit_is_found_from_the_graph_s_guess_to_centimetres(drift):
    T = se3.exp(np.array([0, 0, 0.4, 1.0, 0.5, 0.2]))
    result = verify(job(T, T @ se3.exp(np.array(drift, float))))
    assert result.accepted, result.reason
    assert result.distinct
    error = se3.log(se3.inv(T) @ result.T_older_newer)
    assert np.linalg.norm(error[3:]) < 0.03
    assert np.linalg.norm(error[:3]) < 0.005


@NEEDS_MATCHER
@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, -135.0])
def test_a_true_revisit_is_found_without_a_guess_at_any_heading(yaw_deg: float):
    T = se3.exp(np.array([0, 0, np.radians(yaw_deg), 0, 0, 0])) @ se3.exp(np.array([0.02, -0.03, 0, 2.0, 1.0, 0.1]))
    result = verify(job(T, np.eye(4), by_looks=True))
    assert result.accepted, result.reason
    error = se3.log(se3.inv(T) @ result.T_older_newer)
    assert np.linalg.norm(error[3:]) < 0.03
    assert np.linalg.norm(error[:3]) < 0.005


def test_without_the_matcher_the_heading_of_the_descriptor_is_enough_nearby(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("map_service.loop_search._library", lambda: None)
    T = se3.exp(np.array([0, 0, 2.5, 0, 0, 0])) @ se3.exp(np.array([0, 0, 0, 0.8, 0.5, 0.0]))
    result = verify(job(T, se3.exp(np.array([0, 0, 2.45, 0, 0, 0])), by_looks=True))
    assert result.accepted, result.reason
    assert np.linalg.norm((se3.inv(T) @ result.T_older_newer)[:3, 3]) < 0.03


@pytest.mark.parametrize("by_looks", [False, True])
def test_another_place_is_refused_with_a_reason(by_looks: bool):
    result = verify(job(np.eye(4), np.eye(4), by_looks=by_looks, other_place=True))
    assert not result.accepted
    assert result.reason in ("few_inliers", "not_converged", "no_match", "one_sided")


def test_a_fit_that_tips_the_robot_over_is_refused():
    asked = job(np.eye(4), np.eye(4))
    tipped = LoopJob(3, 90, asked.target_older, asked.source_newer, np.eye(4), UP, np.array([0, 0.1, 0.995]), False,
                     LoopSettings())  # fmt: skip
    assert verify(asked).accepted
    assert verify(tipped).reason == "tipped"


@NEEDS_MATCHER
def test_the_search_gives_the_same_bytes_each_time():
    asked = job(se3.exp(np.array([0, 0, 1.0, 1.0, 0.5, 0])), np.eye(4))
    digests = set()
    for _ in range(5):
        T = search(asked.target_older, asked.source_newer, UP, UP, 0.5)
        assert T is not None
        digests.add(hashlib.sha256(T.tobytes()).hexdigest())
    assert len(digests) == 1


@pytest.mark.parametrize(("count", "half_m"), [(0, 1.0), (1, 1.0), (30, 10.0), (500, 0.5), (1000, 100.0)])
def test_clouds_with_nothing_to_describe_are_no_match_and_no_crash(count: int, half_m: float):
    clouds = np.random.default_rng(1).uniform(-half_m, half_m, (2, count, 3)).astype(np.float32)
    assert search(clouds[0], clouds[1], UP, UP, 0.75) is None
    result = verify(LoopJob(0, 1, clouds[0], clouds[1], np.eye(4), UP, UP, True, LoopSettings()))
    assert result.reason == "no_match"


def corridor(rng: np.random.Generator, count: int, pillars: bool) -> np.ndarray:
    """40 m along x, 3 m wide, 3 m high; pillars every 5 m on one side, doors on the other."""
    x = rng.uniform(-20, 20, count)
    side, z = rng.integers(0, 3, count), rng.uniform(0, 3, count)
    y = np.where(side == 0, -1.5, np.where(side == 1, 1.5, rng.uniform(-1.5, 1.5, count)))
    z = np.where(side == 2, 0.0, z)
    if pillars:
        inside = (np.abs((x + 20) % 5 - 2.5) < 0.4) & (side == 0)
        y = np.where(inside, -0.8, y)
        door = (np.abs((x + 20) % 5 - 1.0) < 0.5) & (side == 1) & (z < 2.1)
        y = np.where(door, 1.9, y)
        flank = rng.random(count) < 0.06
        edge = 5 * rng.integers(0, 8, count) - 20 + 2.5 + rng.choice([-0.4, 0.4], count)
        x, y = np.where(flank, edge, x), np.where(flank, rng.uniform(-1.5, -0.8, count), y)
    return np.column_stack([x, y, z]) + rng.normal(0, 0.01, (count, 3))


def test_a_smooth_corridor_s_fit_says_that_it_leaves_the_way_along_open():
    rng = np.random.default_rng(2)
    pair = CloudPair(corridor(rng, 20_000, False), corridor(rng, 8_000, False), LoopFitSettings())
    turn = se3.exp(np.array([0, 0, 0.5, 0, 0, 0]))
    fit = pair.fit(*pair.align(np.eye(4)))
    sigmas_m = np.sqrt(np.diag(fit.covariance)[3:])
    assert not fit.observed
    assert sigmas_m[0] > 5.0
    assert sigmas_m[1] < 0.05
    assert sigmas_m[2] < 0.05
    # in the frame of the newer keyframe, whatever its heading
    turned = CloudPair(corridor(rng, 20_000, False), corridor(rng, 8_000, False) @ turn[:3, :3], LoopFitSettings())
    fit = turned.fit(*turned.align(turn))
    along = turn[:3, :3].T @ [1.0, 0, 0]
    assert along @ fit.covariance[3:, 3:] @ along > 25.0


def test_a_row_of_pillars_is_known_to_fit_again_a_pillar_further_on():
    rng = np.random.default_rng(2)
    pair = CloudPair(corridor(rng, 20_000, True), corridor(rng, 8_000, True), LoopFitSettings())
    fit = pair.fit(*pair.align(np.eye(4)))
    assert pair.rival(fit, UP, turned=True).share > 0.85
    alone = CloudPair(furnished(rng, 20_000), furnished(rng, 8_000), LoopFitSettings())
    fit = alone.fit(*alone.align(np.eye(4)))
    assert fit.observed
    assert alone.rival(fit, UP, turned=True).share < 0.85


class WholeScores(CloudPair):
    """Looks at all points of every start."""

    def _rough_score(self, source, T, distance_m, enough):
        return self._score(source, T, distance_m)


@pytest.mark.parametrize("pillars", [True, False])
def test_a_few_points_of_a_start_tell_as_much_of_rivals_as_all_of_them(pillars: bool):
    rng = np.random.default_rng(4)
    clouds = corridor(rng, 20_000, pillars), corridor(rng, 8_000, pillars)
    found, expected = (
        kind(*clouds, LoopFitSettings()).rival(kind(*clouds, LoopFitSettings()).fit(np.eye(4), True), UP, turned=False)
        for kind in (CloudPair, WholeScores)
    )
    assert expected.share > 0.85
    assert found.share == expected.share
    np.testing.assert_array_equal(found.T_target_source, expected.T_target_source)


def test_the_covariance_of_a_fit_is_that_of_its_errors_to_a_factor():
    """Twenty draws of the same place: errors are neither far larger than the covariance says nor far smaller."""
    ratios = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        pair = CloudPair(furnished(rng, 8_000), furnished(rng, 4_000), LoopFitSettings())
        fit = pair.fit(*pair.align(np.eye(4)))
        xi = se3.log(fit.T_target_source)
        ratios.append(xi @ np.linalg.solve(fit.covariance, xi) / 6)
    assert 0.05 < np.mean(ratios) < 5.0


class LaterVerifier:
    """Hands out futures that the test fills."""

    def __init__(self) -> None:
        self.jobs: list[tuple[LoopJob, Future[LoopResult]]] = []

    def submit(self, job: LoopJob) -> Future[LoopResult]:
        future: Future[LoopResult] = Future()
        self.jobs.append((job, future))
        return future


def there_and_back(count: int = 3) -> tuple[Keyframes, list[np.ndarray], Chain]:
    keyframes, poses = Keyframes(), []
    cloud, shade = np.zeros((4, 3), np.float32), np.zeros(4, np.uint8)
    for k in range(count):
        T = se3.compose(np.eye(3), np.array([20.0 * (k % 2), 0, 0]))
        poses.append(T)
        keyframes.append(k + 1, k * 40 * SECOND, T, Cloud(cloud, cloud, shade, shade))
    return keyframes, poses, Chain(poses, keyframes.way_m(), [])


def test_results_are_applied_at_a_fixed_number_of_scans_however_fast_they_come():
    keyframes, poses, chain = there_and_back()
    verifier = LaterVerifier()
    closer = LoopCloser(LoopSettings(apply_after_frames=10), verifier)
    closer.look(100, keyframes, poses, [])
    ((request, future),) = verifier.jobs
    assert (request.older, request.newer, request.by_looks) == (0, 2, False)
    again = LoopCloser(LoopSettings(apply_after_frames=10), LaterVerifier())
    again.load(json.loads(json.dumps(closer.dump())), [], keyframes, poses)  # a restart asks for it again
    assert again.dump() == closer.dump()
    future.set_result(LoopResult(0, 2, np.eye(4), np.eye(6) * 1e-4, False, "", 0.9, 0.05, True))
    assert not closer.has_due(109)
    assert closer.due(109, chain) == []
    assert closer.has_due(110)
    assert [a.loop.newer for a in closer.due(110, chain)] == [2]
    assert closer.due(111, chain) == []


@pytest.mark.parametrize(("tied_m", "tried"), [(19.0, 0), (21.0, 1)])
def test_a_place_that_a_loop_has_tied_not_far_back_needs_no_other(tied_m: float, tried: int):
    keyframes, poses, _ = there_and_back(7)
    aside = se3.compose(np.eye(3), np.array([0.0, tied_m / 2, 0.0]))
    for k, T in ((7, poses[6] @ aside), (8, poses[6])):  # there and back once more, to keyframe 0, which 6 is tied to
        keyframes.append(k + 1, k * 40 * SECOND, T, keyframes[6].cloud)
    verifier = LaterVerifier()
    closer = LoopCloser(LoopSettings(), verifier)
    closer.look(100, keyframes, [*poses, poses[6] @ aside, poses[6]], [(0, 6)])
    assert len(verifier.jobs) == tried


@pytest.mark.parametrize(("keyframes_before", "searched"), [(6, False), (13, True)])
def test_places_are_compared_by_looks_once_the_graph_may_be_off_by_more_than_icp_reaches(keyframes_before, searched):
    """0.3 m and 1 % of the way: 1.5 m after 120 m, which are six keyframes of there_and_back."""
    compared = []

    class Watched(PlaceIndex):
        def search(self, points_level, count):
            compared.append(count)

    _, poses, _ = there_and_back(keyframes_before)
    closer = LoopCloser(LoopSettings(), LaterVerifier())
    closer.places = Watched(LoopSettings().places)
    for newest in range(1, keyframes_before):
        part, _, _ = there_and_back(newest + 1)
        closer.look(newest, part, poses[: newest + 1], [])
    assert bool(compared) is searched


def test_the_state_of_the_first_release_is_read():
    keyframes, poses, _ = there_and_back()
    verifier = LaterVerifier()
    closer = LoopCloser(LoopSettings(), verifier)
    closer.load({"last_used": 2, "rejected": {"few_inliers": 3}, "pending": [[110, 0, 2]]}, [], keyframes, poses)
    assert closer.rejected == {"few_inliers": 3}
    assert [(j.older, j.newer) for j, _ in verifier.jobs] == [(0, 2)]


def test_a_dead_verifier_costs_a_loop_and_not_the_session():
    keyframes, poses, chain = there_and_back()
    verifier = LaterVerifier()
    closer = LoopCloser(LoopSettings(apply_after_frames=1), verifier)
    closer.look(2, keyframes, poses, [])
    verifier.jobs[0][1].set_exception(BrokenProcessPool())
    assert closer.due(3, chain) == []
    assert closer.rejected == {"verifier_died": 1}
