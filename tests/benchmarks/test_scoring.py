from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import scoring
from splitslam import se3
from splitslam.alignment import interpolate
from tests.benchmarks.made import SCAN_NS, poses, scans, trajectory, walk

MS = scoring.MS


@pytest.mark.parametrize("offset_ms", [-142, 0, 84])
def test_the_offset_that_a_system_stamps_with_is_found_and_costs_it_nothing(offset_ms: int):
    stamps = scans()
    truth = walk(np.arange(-50, 180, dtype=np.int64) * SCAN_NS)
    estimate = replace(walk(stamps + offset_ms * MS), stamps_ns=stamps)  # the pose of another moment
    result = scoring.score(estimate, truth, stamps, search=True)
    assert result.offset_ns == offset_ms * MS
    assert result.ate_m is not None
    assert result.ate_m < 1e-3
    assert not result.failed


def test_a_system_that_follows_the_conventions_is_scored_as_it_is():
    stamps = scans()
    truth = walk(np.arange(-50, 180, dtype=np.int64) * SCAN_NS)
    late = replace(walk(stamps + 84 * MS), stamps_ns=stamps)
    result = scoring.score(late, truth, stamps, search=False)
    assert result.offset_ns == 0
    assert result.ate_m is not None
    assert result.ate_m > 0.01


def test_the_dense_truth_is_closer_to_a_walking_head_than_straight_lines_are():
    coarse = walk(scans())
    between = scans()[2:-2] + SCAN_NS // 2
    exact = walk(between).positions_m
    line_m = np.linalg.norm(interpolate(coarse, between).positions_m - exact, axis=1).max()
    spline_m = np.linalg.norm(interpolate(scoring.dense(coarse), between).positions_m - exact, axis=1).max()
    assert line_m > 3e-3
    assert spline_m < line_m / 4


def test_scans_without_a_pose_are_missing_and_many_of_them_are_a_failure():
    stamps = scans()
    truth = walk(stamps)
    few = walk(stamps)[np.arange(len(stamps)) % 20 != 3]
    many = walk(stamps)[np.arange(len(stamps)) % 4 != 3]
    assert scoring.score(few, truth, stamps, search=False).missing == 6
    assert not scoring.score(few, truth, stamps, search=False).failed
    assert scoring.score(many, truth, stamps, search=False).missing == 30
    assert scoring.score(many, truth, stamps, search=False).failed


def test_poses_that_are_not_numbers_count_as_missing():
    stamps = scans()
    estimate = walk(stamps)
    estimate.positions_m[40:60] = np.nan
    result = scoring.score(estimate, walk(stamps), stamps, search=False)
    assert result.missing == 20
    assert result.failed


def test_no_trajectory_at_all_is_a_failure_with_every_pose_missing():
    stamps = scans()
    for nothing in (None, walk(stamps + 3600 * 1_000_000_000)):
        result = scoring.score(nothing, walk(stamps), stamps, search=True)
        assert (result.ate_m, result.missing, result.failed) == (None, len(stamps), True)


def test_a_trajectory_that_runs_away_has_diverged_and_one_that_drifts_has_not():
    stamps = scans()
    truth = walk(stamps)
    away = np.linspace(0.0, 1.0, len(stamps)) ** 4
    drifting = replace(truth, positions_m=truth.positions_m + away[:, None] * [0.4, 0.0, 0.0])
    running = replace(truth, positions_m=truth.positions_m + away[:, None] * [8.0, 0.0, 0.0])
    assert not scoring.score(drifting, truth, stamps, search=False).diverged
    assert scoring.score(running, truth, stamps, search=False).diverged
    assert scoring.score(running, truth, stamps, search=False).failed


def test_where_a_trajectory_starts_and_how_it_is_turned_does_not_matter():
    stamps = scans()
    truth = walk(stamps)
    T = se3.exp(np.array([0.1, -0.2, 2.0, 5.0, -3.0, 1.0]))
    moved = trajectory(stamps, [T @ pose for pose in poses(truth)])
    ate_m = scoring.score(moved, truth, stamps, search=False).ate_m
    assert ate_m == pytest.approx(0.0, abs=1e-9)
