from __future__ import annotations

import numpy as np
import pytest

from edge_agent.deskew.reference import deskew_float64
from splitslam.codec import quantise_knots
from splitslam.features import Knots
from tests.deskew.motions import HEAD_TURN_RADPS, far_points, imu_offsets, turning


@pytest.mark.parametrize("rate_hz", [10, 50, 100, 200, 300, 400, 500, 1000])
@pytest.mark.parametrize("phase", [0.0, 0.3, np.pi / 2])
def test_the_wire_grid_moves_points_by_less_than_a_millimetre_at_30_m(rate_hz: float, phase: float):
    knots = turning(imu_offsets(rate_hz), HEAD_TURN_RADPS, phase=phase)
    points, t = far_points(3000, 30.0)
    points = points.astype(np.float64)
    moved = deskew_float64(points, t, quantise_knots(knots)) - deskew_float64(points, t, knots)
    assert np.linalg.norm(moved, axis=1).max() < 1e-3


@pytest.mark.parametrize("rate_hz", [10, 90, 200, 500, 1000])
@pytest.mark.parametrize("end_ns", [99_876_543, 100_000_000, 1_000_000_000])
def test_quantising_twice_changes_nothing(rate_hz: float, end_ns: int):
    once = quantise_knots(turning(imu_offsets(rate_hz, end_ns), HEAD_TURN_RADPS))
    twice = quantise_knots(once)
    np.testing.assert_array_equal(twice.offsets_ns, once.offsets_ns)
    np.testing.assert_array_equal(twice.rotation, once.rotation)
    np.testing.assert_array_equal(twice.translation_m, once.translation_m)
    assert len(once.offsets_ns) <= 33
    assert once.offsets_ns[0] <= 0
    assert once.offsets_ns[-1] >= end_ns  # the whole scan stays covered


def test_a_slow_imu_keeps_its_own_knots():
    """Between the two samples of a 10 Hz IMU the rate steps; resampling elsewhere would round the corner off."""
    knots = turning(np.array([0, 41_234_567, 100_000_000]), 2.0)
    np.testing.assert_array_equal(quantise_knots(knots).offsets_ns, [0, 41_234_000, 100_000_000])


def test_knots_that_do_not_move_stay_exactly_still():
    still = Knots(np.array([0, 100_000_000]), np.zeros((2, 3)), np.zeros((2, 3)))
    q = quantise_knots(still)
    assert not q.rotation.any()
    assert not q.translation_m.any()
