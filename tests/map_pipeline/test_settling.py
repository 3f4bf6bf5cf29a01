"""What a frame means for the map is done after its answer, and before anybody can see that it was not."""

from __future__ import annotations

import numpy as np

from map_service.pipeline import MapPipeline
from map_service.settings import LoopSettings, PipelineSettings
from map_service.types import CorrectionRecord
from splitslam.robot import Robot
from tests.map_pipeline.made_walks import SECOND, DriftingTracker, Inline, along, frame, scan, town

STRAIGHT = np.zeros(6)


def made(way: list[tuple[float, float]], drift: np.ndarray) -> tuple[MapPipeline, list]:
    """A pipeline that has seen nothing yet, and the frames of a walk."""
    truth, rng, world = along(way), np.random.default_rng(21), town(1)
    settings = PipelineSettings(loops=LoopSettings(apply_after_frames=2))
    pipeline = MapPipeline(Robot(imu=None, gnss=None), settings, Inline())
    pipeline.tracker = DriftingTracker(truth, drift)
    return pipeline, [frame(k + 1, scan(world, T, rng), k * SECOND) for k, T in enumerate(truth)]


def test_an_answer_waits_for_no_keyframe_and_the_next_one_for_all_of_it():
    pipeline, frames = made([(0, 0), (6, 0)], STRAIGHT)
    assert pipeline.answer(frames[0]).keyframe
    assert len(pipeline.keyframes) == len(pipeline.graph.poses) == len(pipeline.frames) == 0
    assert pipeline.answer(frames[1]).keyframe
    assert len(pipeline.keyframes) == len(pipeline.graph.poses) == len(pipeline.frames) == 1
    assert pipeline.settle() is not None
    assert len(pipeline.keyframes) == 2
    assert pipeline.settle() is None
    assert len(pipeline.keyframes) == 2


def test_a_commit_holds_the_frame_that_was_answered_last():
    pipeline, frames = made([(0, 0), (6, 0)], STRAIGHT)
    for one in frames[:2]:
        pipeline.answer(one)
    commit = pipeline.take_commit()
    assert ([f.seq for f in commit.frames], [k.index for k in commit.keyframes]) == ([1, 2], [0, 1])


def test_what_a_loop_corrects_is_told_with_the_next_answer_and_stored_with_its_own():
    pipeline, frames = made([(0, 0), (36, 0), (0, 0.5)], np.array([0, 0, 0, 0.0, 0.012, 0]))
    told: dict[int, CorrectionRecord] = {}
    corrected_by = None
    for one in frames:
        before = pipeline.stats.largest_correction_m
        answer = pipeline.answer(one)
        if answer.correction is not None:
            told[one.seq] = answer.correction
        pipeline.settle()
        if corrected_by is None and pipeline.stats.largest_correction_m > before:
            corrected_by = one.seq
            moved = pipeline.graph.poses[pipeline.frames[-1].keyframe] @ pipeline.frames[-1].T_keyframe_lidar
            assert np.linalg.norm(moved[:3, 3] - answer.T_map_lidar[:3, 3]) > 0.05
    assert corrected_by is not None
    assert min(told) == corrected_by + 1
