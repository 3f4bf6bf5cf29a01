from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.consistency import consistency, read_doubt
from splitslam import se3
from splitslam.errors import InputError
from tests.benchmarks.made import poses, scans, trajectory, walk

STAMPS = scans(60.0)
TRUTH = walk(STAMPS)
SIGMAS = np.array([1e-3, 2e-3, 4e-3, 0.01, 0.02, 0.03])
NEES_MEAN = 0.1  # standard deviation of a mean of 600 is sqrt(2 / 6 / 600) = 0.024: four of them


def answers(sigmas: np.ndarray, origin_sigmas: np.ndarray, seed: int = 1, stamps: np.ndarray = STAMPS):
    """Answers in a turned map frame, with correlated errors of this size; covariances that say so."""
    rng = np.random.default_rng(seed)
    mix = np.linalg.qr(rng.normal(size=(6, 6)))[0] * 0.3 + np.eye(6)
    T_map_world = se3.exp(np.array([0.02, -0.01, 1.1, 3.0, 2.0, -1.0]))
    each = np.tile(sigmas, (len(stamps), 1))
    each[0] = origin_sigmas
    errors = (each * rng.normal(size=each.shape)) @ mix.T
    X = [T_map_world @ G @ se3.exp(e) for G, e in zip(poses(walk(stamps)), errors, strict=True)]
    return trajectory(stamps, X), np.einsum("ij,kj,lj->kil", mix, each**2, mix)


def test_honest_answers_have_a_nees_of_one():
    online, covariances = answers(SIGMAS, np.full(6, 1e-9))
    result = consistency(online, covariances, TRUTH)
    assert result is not None
    assert result.n == len(STAMPS) - 1
    for value in (result.mean, result.rotation, result.translation, result.origin_exact):
        assert value == pytest.approx(1.0, abs=NEES_MEAN)
    assert result.median == pytest.approx(0.89, abs=NEES_MEAN)


@pytest.mark.parametrize("claimed", [0.5, 2.0])
def test_claiming_half_or_twice_the_errors_shows_as_four_or_a_quarter(claimed: float):
    online, covariances = answers(SIGMAS, np.full(6, 1e-9))
    result = consistency(online, covariances * claimed**2, TRUTH)
    assert result is not None
    assert result.mean == pytest.approx(1.0 / claimed**2, rel=NEES_MEAN)


def test_the_doubt_of_the_first_pose_counts_for_all_that_follow():
    means, exact = [], []
    for seed in range(200):  # the origin is drawn once a run, so that it takes many runs
        result = consistency(*answers(SIGMAS, SIGMAS, seed, STAMPS[:60:10]), TRUTH)
        assert result is not None
        means.append(result.mean)
        exact.append(result.origin_exact)
    assert np.mean(means) == pytest.approx(1.0, abs=NEES_MEAN)
    assert np.mean(exact) > 1.5


def test_drift_is_not_aligned_away():
    """A heading that turns by 2 mrad over the drive, all of it, and not what is left after the best alignment."""
    X = [G @ se3.exp(np.array([0, 0, 2e-3 * k / len(STAMPS), 0, 0, 0])) for k, G in enumerate(poses(TRUTH))]
    result = consistency(trajectory(STAMPS, X), np.tile(np.eye(6) * 1e-8, (len(STAMPS), 1, 1)), TRUTH)
    assert result is not None
    assert result.rotation == pytest.approx((2e-3) ** 2 / 3 / 2e-8 / 3, rel=0.01)  # over P_k + P_0, of three


def test_answers_outside_the_truth_are_not_scored():
    online, covariances = answers(SIGMAS, SIGMAS)
    result = consistency(online, covariances, TRUTH[100:200])
    assert result is not None
    assert result.n == 99
    assert consistency(online, covariances, TRUTH[100:101]) is None


def test_the_file_of_covariances_is_read_back(tmp_path: Path):
    rng = np.random.default_rng(4)
    half = rng.normal(size=(2, 6, 6))
    P = half @ half.transpose(0, 2, 1)
    upper = np.triu_indices(6)
    lines = [f"{17 + k},{state}," + ",".join(map(repr, P[k][upper].tolist())) for k, state in enumerate(("a", "b"))]
    path = tmp_path / "online_covariance.csv"
    path.write_text("\n".join(["header", *lines]) + "\n")
    doubt = read_doubt(path)
    np.testing.assert_array_equal(doubt.covariances, P)
    assert doubt.stamps_ns.tolist() == [17, 18]
    assert doubt.state_shares == {"a": 0.5, "b": 0.5}
    path.write_text("header\n17,tracking,1,2\n")
    with pytest.raises(InputError, match=r"expected stamp_ns, state and 21 numbers"):
        read_doubt(path)
