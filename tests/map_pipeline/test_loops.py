from __future__ import annotations

import json
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest

from map_service.loops import LoopJob, LoopResult, candidate, verify
from map_service.settings import LoopSettings
from splitslam import se3
from tests.map_pipeline.naive import room

SECOND = 1_000_000_000


def test_a_candidate_is_near_and_old():
    positions = np.array([[0.0, 0, 0], [5, 0, 0], [20, 0, 0], [5, 1, 0]])
    stamps = np.array([0, 10, 40, 60]) * SECOND
    s = LoopSettings(radius_m=10, min_age_s=30)
    assert candidate(positions, stamps, 3, -1, s) == 1  # the nearest of two
    assert candidate(positions, stamps, 2, -1, s) is None  # too far
    assert candidate(positions, stamps[:2], 1, -1, s) is None  # too young
    assert candidate(positions, stamps, 3, 1, s) is None  # one was tried a metre ago


def job(T_true: np.ndarray, T_guess: np.ndarray, other_place: bool = False) -> LoopJob:
    rng = np.random.default_rng(5)
    target, _ = room(rng, 20_000, 0.02)
    source, poles = room(rng, 8_000, 0.02)
    if other_place:
        source = np.column_stack([rng.uniform(-8, 8, (8000, 2)), rng.uniform(0, 4, 8000)])
    T = se3.inv(T_true)
    return LoopJob(
        3,
        90,
        np.concatenate([target, poles]).astype(np.float32),
        (np.concatenate([source, poles]) @ T[:3, :3].T + T[:3, 3]).astype(np.float32),
        T_guess,
        LoopSettings(),
    )


@pytest.mark.parametrize("drift", [[0, 0, 0.02, 0.3, -0.2, 0.1], [0.01, 0, -0.05, -0.5, 0.6, 0]])
def test_a_true_revisit_is_accepted_with_the_motion_to_centimetres(drift):
    T = se3.exp(np.array([0, 0, 0.4, 1.0, 0.5, 0.2]))
    result = verify(job(T, T @ se3.exp(np.array(drift, float))))
    assert result.accepted, result.reason
    error = se3.log(se3.inv(T) @ result.T_older_newer)
    assert np.linalg.norm(error[3:]) < 0.03
    assert np.linalg.norm(error[:3]) < 0.005


def test_another_place_is_refused_with_a_reason():
    result = verify(job(np.eye(4), np.eye(4), other_place=True))
    assert not result.accepted
    assert result.reason in ("few_inliers", "not_converged", "too_far")


class LaterVerifier:
    """Hands out futures that the test fills."""

    def __init__(self) -> None:
        self.jobs: list[tuple[LoopJob, Future[LoopResult]]] = []

    def submit(self, job: LoopJob) -> Future[LoopResult]:
        future: Future[LoopResult] = Future()
        self.jobs.append((job, future))
        return future


def test_results_are_applied_at_a_fixed_number_of_scans_however_fast_they_come():
    from map_service.closing import LoopCloser
    from map_service.keyframes import Keyframe, Keyframes

    keyframes, poses = Keyframes(), []
    cloud, shade = np.zeros((4, 3), np.float32), np.zeros(4, np.uint8)
    for k in range(3):
        T = se3.compose(np.eye(3), np.array([20.0 * (k % 2), 0, 0]))
        poses.append(T)
        keyframes.append(Keyframe(k, k + 1, k * 40 * SECOND, T, cloud, cloud, shade, shade))
    verifier = LaterVerifier()
    closer = LoopCloser(LoopSettings(apply_after_frames=10), verifier)
    closer.look(100, keyframes, poses)
    ((request, future),) = verifier.jobs
    assert (request.older, request.newer) == (0, 2)
    again = LoopCloser(LoopSettings(apply_after_frames=10), LaterVerifier())
    again.load(json.loads(json.dumps(closer.dump())), keyframes, poses)  # a restart asks for it again
    assert again.dump() == closer.dump()
    future.set_result(LoopResult(0, 2, np.eye(4), True, "", 0.9, 0.05))
    assert closer.due(109) == []
    assert [r.newer for r in closer.due(110)] == [2]
    assert closer.due(111) == []


def test_a_dead_verifier_costs_a_loop_and_not_the_session():
    from map_service.closing import LoopCloser
    from map_service.keyframes import Keyframe, Keyframes

    keyframes, poses = Keyframes(), []
    cloud, shade = np.zeros((4, 3), np.float32), np.zeros(4, np.uint8)
    for k in range(2):
        poses.append(np.eye(4))
        keyframes.append(Keyframe(k, k + 1, k * 40 * SECOND, np.eye(4), cloud, cloud, shade, shade))
    verifier = LaterVerifier()
    closer = LoopCloser(LoopSettings(apply_after_frames=1), verifier)
    closer.look(2, keyframes, poses)
    verifier.jobs[0][1].set_exception(BrokenProcessPool())
    assert closer.due(3) == []
    assert closer.rejected == {"verifier_died": 1}
