"""What a pipeline shows of itself: what it registered with, and nothing changes by looking."""

from __future__ import annotations

import numpy as np

from map_service.pipeline import MapPipeline
from map_service.seen import map_seen
from map_service.settings import PipelineSettings
from splitslam import se3
from splitslam.registration._kernels import GEOMETRY, KIND
from splitslam.robot import Robot
from tests.map_pipeline.made_drives import Receiver, ahead, driven, fixes
from tests.map_pipeline.made_walks import Inline
from tests.map_pipeline.test_tracker import STEP, frame

START = se3.compose(np.eye(3), np.array([-1.0, -0.5, 1.2]))
FRAMES = 8


def drive(looking: bool) -> tuple[MapPipeline, list]:
    pipeline = MapPipeline(Robot(imu=None, gnss=None), PipelineSettings(), Inline())
    rng, seen = np.random.default_rng(1), []
    for seq in range(1, FRAMES + 1):
        answer = pipeline.answer(frame(seq, START @ np.linalg.matrix_power(STEP, seq - 1), rng))
        if looking:
            seen.append((answer, *pipeline.seen(100)))
        pipeline.settle()
    return pipeline, seen


def test_looking_changes_nothing():
    looked_at, left_alone = drive(looking=True)[0], drive(looking=False)[0]
    for a, b in zip(looked_at.trajectory(), left_alone.trajectory(), strict=True):
        np.testing.assert_array_equal(a[2], b[2])


def test_features_are_matched_with_the_lines_and_planes_that_the_registration_found_there():
    pipeline, seen = drive(looking=True)
    assert np.isnan(seen[0][1].surf_matches_lidar).all(), "the first scan has no map to be matched with"
    for answer, scan, _ in seen[1:]:
        assert len(scan.surfs_lidar) == len(scan.surf_matches_lidar)
        matches = np.concatenate([scan.corner_matches_lidar, scan.surf_matches_lidar])
        found = int(np.isfinite(matches[:, 0]).sum())
        assert answer.effort is not None
        assert answer.effort.inliers <= found <= answer.effort.features
    answer = pipeline.answer(frame(FRAMES + 1, START @ np.linalg.matrix_power(STEP, FRAMES), np.random.default_rng(2)))
    scan, _ = pipeline.seen(100)
    assert scan is not None
    track, surfs = pipeline.tracker, scan.surfs_lidar
    T = se3.inv(pipeline.map_frame.T_map_local) @ answer.T_map_lidar
    fits = np.empty((len(surfs), GEOMETRY))
    track.local_map.surfs.match(surfs.astype(np.float64), T, track.settings.registration.gate_end_m, fits)
    matched = fits[:, KIND] != 0.0
    back = se3.inv(T)
    means_lidar = fits[matched, :3] @ back[:3, :3].T + back[:3, 3]
    np.testing.assert_allclose(scan.surf_matches_lidar[matched], means_lidar, atol=1e-5)


def test_a_scan_says_which_keyframe_it_is_or_hangs_on():
    pipeline, seen = drive(looking=True)
    keyframes = 0
    for answer, scan, map_ in seen:
        assert len(map_.T_map_keyframes) == len(pipeline.graph.poses) or len(map_.T_map_keyframes) >= keyframes
        keyframes += answer.keyframe
        assert scan.keyframe == keyframes - 1
    assert keyframes == len(pipeline.graph.poses) >= 2


def test_the_fixes_that_are_shown_lie_where_the_graph_has_them():
    truth = ahead(150.0, 2.0)
    outcome = driven(truth, fixes(truth, Receiver()))
    graph = outcome.pipeline.graph
    shown = map_seen(graph, 10)
    assert len(shown.fix_keyframes) == 10
    all_of_them = map_seen(graph, 10_000)
    assert len(all_of_them.fix_keyframes) == outcome.pipeline.stats.gnss_factors
    np.testing.assert_array_equal(all_of_them.fixes_map[-10:], shown.fixes_map)
    keyframes_m = graph.poses.positions_m[all_of_them.fix_keyframes]
    off_m = np.linalg.norm(all_of_them.fixes_map[:, :2] - keyframes_m[:, :2], axis=1)
    assert np.median(off_m) < 3.0, "a receiver of half a metre, and up to a keyframe's spacing of way"
