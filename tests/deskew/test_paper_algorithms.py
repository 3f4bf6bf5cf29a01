"""Algorithms 1 and 2 and equations 1 and 2 of the paper, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.deskew import reference
from edge_agent.deskew.reference import EulerMotion, algorithm_1, algorithm_2, equation_1, equation_2
from splitslam import se3
from splitslam.features import Knots


def motion(start_s: float = 0.0) -> EulerMotion:
    """Turning and walking for 0.1 s; IMU samples before, in and after the scan."""
    return EulerMotion(
        angles_rad=np.array([[0.0, 0.0, 0.0], [0.01, -0.02, 0.1], [0.02, 0.01, 0.3], [0.02, 0.02, 0.4]]),
        times_s=start_s + np.array([-0.02, 0.03, 0.08, 0.11]),
        o_inc_m=np.array([0.2, -0.1, 0.05]),
        start_s=start_s,
        end_s=start_s + 0.1,
    )


def rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rz Ry Rx from the three textbook matrices."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    Rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    Ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    Rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return Rz @ Ry @ Rx


def test_equation_1_weights_the_sample_nearer_in_time_more():
    """The paper prints t_a <= t <= t_b; taken literally the weights would be swapped or negative."""
    angles = equation_1(0.04, motion())  # 10 ms after the sample at 30 ms, 40 ms before the one at 80 ms
    np.testing.assert_allclose(angles, [0.012, -0.014, 0.14], atol=1e-12)


def test_equation_1_holds_the_last_sample_and_the_first():
    np.testing.assert_array_equal(equation_1(0.2, motion()), [0.02, 0.02, 0.4])
    np.testing.assert_array_equal(equation_1(-0.5, motion()), [0.0, 0.0, 0.0])


def test_equation_2_measures_time_from_the_start_of_the_scan():
    """Without `- t_start`, as printed, a Unix time would move the point by billions of metres."""
    epoch = 1.7e9
    np.testing.assert_allclose(equation_2(epoch + 0.025, motion(epoch)), [0.05, -0.025, 0.0125], atol=1e-6)


def test_algorithm_2_is_the_product_of_the_inverse_first_pose_and_the_pose_at_the_point():
    m = motion()
    p = np.array([30.0, -4.0, 1.5])
    first = se3.compose(rotation(0.004, -0.008, 0.04), np.zeros(3))  # at t = 0: 40 % of the way to the 2nd sample
    at_point = se3.compose(rotation(0.016, -0.002, 0.22), 0.6 * m.o_inc_m)  # t = 0.06: 60 % of the way to the 3rd
    expected = (np.linalg.inv(first) @ at_point @ np.append(p, 1.0))[:3]
    M_inv = se3.inv(se3.compose(reference.euler_matrix(equation_1(0.0, m)), equation_2(0.0, m)))
    np.testing.assert_allclose(algorithm_2(p, 0.06, m, M_inv), expected, atol=1e-12)
    assert np.linalg.norm(expected - p) > 1.0  # the case moves points: a deskew that does nothing would be seen


def test_algorithm_1_keeps_raw_ranges_and_the_first_point_of_a_cell():
    m = motion()
    points = np.array([[10.0, 0, 0], [10.001, 0.001, 0], [0, 5.0, 1.0], [3.0, -3.0, 0.0], [4.0, 0, 0]])
    times = np.array([0.0, 0.01, 0.05, 0.09, 0.095])
    rings = np.array([0, 0, 1, 7, 1])  # the second falls into the first one's cell, the fourth on no ring
    result = algorithm_1(points, times, rings, m, (2, 1800))
    np.testing.assert_array_equal(result.columns, [900, 1350, 900])
    np.testing.assert_array_equal(result.rings, [0, 1, 1])
    np.testing.assert_allclose(result.ranges_m, [10.0, np.sqrt(26.0), 4.0])
    np.testing.assert_allclose(result.points_deskewed[0], points[0], atol=1e-12)  # the first point is the reference
    M_inv = se3.inv(se3.compose(reference.euler_matrix(equation_1(0.0, m)), np.zeros(3)))
    for k, i in enumerate([0, 2, 4]):
        np.testing.assert_allclose(result.points_deskewed[k], algorithm_2(points[i], times[i], m, M_inv), atol=1e-12)


def test_the_paper_and_the_knots_agree_where_euler_angles_are_exact():
    """About one axis, linear Euler interpolation is slerp: both references must give the same points."""
    times = np.array([0.0, 0.02, 0.05, 0.1])
    yaw = np.array([0.0, 0.05, 0.11, 0.38])
    rng = np.random.default_rng(1)
    points = rng.uniform(-50, 50, (40, 3))
    t = np.sort(rng.uniform(0, 0.1, 40))
    t[0] = 0.0
    angles = np.stack([0 * yaw, 0 * yaw, yaw], axis=1)
    m = EulerMotion(angles, times, np.array([0.3, 0.1, 0.0]), 0.0, 0.1)
    translation = times[:, None] / 0.1 * m.o_inc_m
    knots = Knots(np.rint(times * 1e9).astype(np.int64), angles, translation)
    by_knots = reference.deskew_float64(points, np.rint(t * 1e9).astype(np.int32), knots)
    by_paper = np.array([algorithm_2(p, ti, m, np.eye(4)) for p, ti in zip(points, t, strict=True)])
    np.testing.assert_allclose(by_knots, by_paper, atol=1e-6)


@pytest.mark.parametrize(
    ("azimuth_deg", "column"), [(0.0, 900), (90.0, 1350), (-90.0, 450), (179.95, 0), (-179.95, 0), (0.31, 902)]
)
def test_columns_grow_counter_clockwise_with_x_in_the_middle(azimuth_deg: float, column: int):
    a = np.radians(azimuth_deg)
    assert reference.lio_sam_column(np.array([np.cos(a), np.sin(a), 0.3]), 1800) == column
