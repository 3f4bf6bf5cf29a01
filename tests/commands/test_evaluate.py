from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splitslam.alignment import interpolate
from splitslam.errors import InputError
from splitslam.evaluate import evaluate
from splitslam.tum import Trajectory
from tests.commands import naive_evaluation

EPOCH_NS = 1_700_000_000_000_000_000


def trajectory(seconds, positions_m, rotations: Rotation | None = None) -> Trajectory:
    stamps_ns = EPOCH_NS + np.round(np.asarray(seconds, float) * 1e9).astype(np.int64)
    quats = Rotation.identity(len(stamps_ns)).as_quat() if rotations is None else rotations.as_quat()
    return Trajectory(stamps_ns, np.asarray(positions_m, float), quats)


def about_z_deg(*angles: float) -> Rotation:
    return Rotation.from_euler("z", np.array(angles)[:, None], degrees=True)


def straight_drive(speed_mps: float = 1.0, seconds: float = 20.0) -> Trajectory:
    t = np.arange(0.0, seconds + 0.05, 0.1)
    return trajectory(t, np.column_stack([speed_mps * t, 0.1 * np.sin(t), 0.05 * np.cos(3 * t)]))


def moved(path: Trajectory, rotation: Rotation, shift_m) -> Trajectory:
    quats = (rotation * Rotation.from_quat(path.quats_xyzw)).as_quat()
    return Trajectory(path.stamps_ns, rotation.apply(path.positions_m) + np.asarray(shift_m), quats)


def wandering(seed: int, count: int = 60) -> tuple[Trajectory, Trajectory]:
    """A truth at 12 Hz and a noisy, drifting estimate at its own uneven stamps in its own frame."""
    rng = np.random.default_rng(seed)
    truth = trajectory(
        np.cumsum(rng.uniform(0.05, 0.12, count)),
        np.cumsum(rng.normal([0.4, 0, 0], 0.3, (count, 3)), axis=0),
        Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.15, (count, 3)), axis=0)),
    )
    at = np.sort(rng.uniform(truth.stamps_ns[0] - 5e8, truth.stamps_ns[-1] + 5e8, count).astype(np.int64))
    seen = interpolate(truth, at.clip(truth.stamps_ns[0], truth.stamps_ns[-1]))
    noisy = (Rotation.from_quat(seen.quats_xyzw) * Rotation.from_rotvec(rng.normal(0, 0.02, (count, 3)))).as_quat()
    estimate = Trajectory(at, seen.positions_m + np.cumsum(rng.normal(0, 0.02, (count, 3)), axis=0), noisy)
    return moved(estimate, Rotation.from_rotvec(rng.normal(0, 1, 3)), rng.normal(0, 50, 3)), truth


def test_a_trajectory_in_another_frame_is_without_error():
    truth = straight_drive()
    score = evaluate(moved(truth, Rotation.from_euler("xyz", [0.3, -0.2, 2.5]), [100, -20, 3]), truth)
    assert asdict(score) == pytest.approx(
        {"n": 201, "outside": 0} | dict.fromkeys(("ate_m", "max_m", "rpe_1s_m", "rpe_10m_m", "end_m"), 0.0), abs=1e-9
    )


def test_scale_is_not_corrected():
    truth = trajectory(range(21), [[float(x), 0, 0] for x in range(21)])
    score = evaluate(Trajectory(truth.stamps_ns, 1.1 * truth.positions_m, truth.quats_xyzw), truth)
    assert score.ate_m == pytest.approx(0.1 * np.sqrt(np.mean((np.arange(21) - 10.0) ** 2)))
    assert score.max_m == pytest.approx(1.0)
    assert score.rpe_1s_m == pytest.approx(0.1)
    assert score.rpe_10m_m == pytest.approx(1.0)
    assert score.end_m == pytest.approx(2.0)


def test_a_wrong_first_heading_swings_the_end_but_not_the_ate():
    truth = trajectory(range(11), [[float(x), 0, 0] for x in range(11)])
    turned = about_z_deg(90, *[0] * 10)
    score = evaluate(trajectory(range(11), truth.positions_m, turned), truth)
    assert score.ate_m == pytest.approx(0.0, abs=1e-12)
    assert score.end_m == pytest.approx(10 * np.sqrt(2))
    assert score.rpe_1s_m == pytest.approx(np.sqrt((np.sqrt(2) ** 2) / 10))


def test_truth_is_interpolated_and_poses_outside_it_are_counted_not_scored():
    truth = trajectory([0, 2], [[0, 0, 0], [2, 0, 0]], about_z_deg(0, 90))
    estimate = trajectory([-0.1, 0.5, 1.0, 2.0, 2.1], [[9, 9, 9], [0.5, 0, 0], [1, 0, 0], [2, 0, 0], [9, 9, 9]])
    score = evaluate(estimate, truth)
    assert (score.n, score.outside) == (3, 2)
    assert score.ate_m == pytest.approx(0.0, abs=1e-12)
    half_way = Rotation.from_quat(interpolate(truth, truth.stamps_ns[:1] + 10**9).quats_xyzw[0])
    assert half_way.magnitude() == pytest.approx(np.pi / 4)


def test_interpolation_goes_the_short_way_between_q_and_minus_q():
    rotations = about_z_deg(10, 20)
    truth = trajectory([0, 1], np.zeros((2, 3)), rotations)
    flipped = Trajectory(truth.stamps_ns, truth.positions_m, truth.quats_xyzw * [[1.0], [-1.0]])
    quat = interpolate(flipped, truth.stamps_ns[:1] + 5 * 10**8).quats_xyzw[0]
    assert np.degrees(Rotation.from_quat(quat).magnitude()) == pytest.approx(15.0)


def test_relative_errors_need_a_partner_one_second_or_ten_metres_on():
    score = evaluate(straight_drive(seconds=0.9), straight_drive(seconds=0.9))
    assert score.rpe_1s_m is None
    assert score.rpe_10m_m is None
    assert evaluate(straight_drive(seconds=5), straight_drive(seconds=5)).rpe_1s_m == pytest.approx(0.0, abs=1e-12)


def test_the_partner_is_the_first_pose_at_least_one_second_on_to_the_nanosecond():
    estimate = trajectory([0.0, 0.999999999, 1.0], [[0, 0, 0], [5, 0, 0], [1.25, 0, 0]])
    truth = trajectory([0.0, 1.0], [[0, 0, 0], [1, 0, 0]])
    assert evaluate(estimate, truth).rpe_1s_m == pytest.approx(0.25)


@pytest.mark.parametrize("seed", range(8))
def test_the_evaluation_agrees_with_its_naive_twin(seed: int):
    estimate, truth = wandering(seed)
    score = asdict(evaluate(estimate, truth))
    assert score["outside"] > 0
    assert score["rpe_10m_m"] is not None
    assert score == pytest.approx(naive_evaluation.evaluate(estimate, truth), rel=1e-7, abs=1e-9)


def test_no_common_time_is_an_input_error():
    truth = straight_drive()
    late = Trajectory(truth.stamps_ns + 10**12, truth.positions_m, truth.quats_xyzw)
    with pytest.raises(
        InputError, match=r"expected poses in the truth's time span 1700000000\.000 s to 1700000020\.000 s"
    ):
        evaluate(late, truth)
