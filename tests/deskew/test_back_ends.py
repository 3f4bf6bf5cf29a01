from __future__ import annotations

import numpy as np
import pytest

from edge_agent.deskew import make_deskewer
from edge_agent.deskew.reference import deskew_float64
from edge_agent.image_node import make_image_node
from edge_agent.settings import PipelineSettings
from splitslam.errors import InputError
from splitslam.features import Knots
from tests.deskew.motions import FAST_TURN_RADPS, far_points, imu_offsets, turning
from tests.tolerances import DESKEW_CPU_M, DESKEW_RANGE_M


@pytest.mark.parametrize("rate_hz", [10, 100, 250, 500, 1000])
@pytest.mark.parametrize("phase", [0.3, np.pi / 2])  # turning faster, turning at the peak rate
def test_cpu_is_within_a_millimetre_of_the_reference_at_100_m_and_217_deg_per_s(rate_hz: float, phase: float):
    knots = turning(imu_offsets(rate_hz), FAST_TURN_RADPS, phase=phase)
    points, t = far_points(4000, DESKEW_RANGE_M)
    exact = deskew_float64(points.astype(np.float64), t, knots)
    out = make_deskewer("cpu").deskew(points, t, knots, np.empty_like(points))
    assert np.linalg.norm(out - exact, axis=1).max() <= DESKEW_CPU_M
    assert np.linalg.norm(out - points, axis=1).max() > 5.0


def test_the_reference_removes_the_motion_of_a_made_scan():
    """A wall of known points seen from a moving sensor comes back as the wall."""
    knots = turning(imu_offsets(1000), FAST_TURN_RADPS)
    wall, _ = far_points(500, 20.0, seed=3)
    t = np.random.default_rng(4).choice(knots.offsets_ns, 500).astype(np.int32)  # at knots the pose is exact
    seen = []
    for p, ti in zip(wall.astype(np.float64), t, strict=True):
        k = int(np.searchsorted(knots.offsets_ns, ti))
        angle = np.linalg.norm(knots.rotation[k])
        axis = knots.rotation[k] / angle if angle > 0 else np.array([1.0, 0, 0])
        v = p - knots.translation_m[k]
        # Rodrigues' rotation of a vector by minus the angle
        c, s = np.cos(-angle), np.sin(-angle)
        seen.append(v * c + np.cross(axis, v) * s + axis * (axis @ v) * (1 - c))
    out = make_deskewer("reference").deskew(np.array(seen, np.float32), t, knots, np.empty((500, 3), np.float32))
    np.testing.assert_allclose(out, wall, atol=1e-5)


@pytest.mark.parametrize("name", ["reference", "cpu"])
def test_points_before_and_after_the_knots_take_the_end_knots_pose(name: str):
    knots = turning(np.array([10_000_000, 40_000_000, 90_000_000]), FAST_TURN_RADPS)
    p = np.tile(np.array([[30.0, 5.0, 1.0]], np.float32), (4, 1))
    t = np.array([0, 10_000_000, 90_000_000, 100_000_000], np.int32)
    out = make_deskewer(name).deskew(p, t, knots, np.empty_like(p))
    np.testing.assert_array_equal(out[0], out[1])
    np.testing.assert_array_equal(out[2], out[3])
    assert np.linalg.norm(out[1] - out[2]) > 1.0


def test_off_leaves_points_and_motion_alone():
    knots = turning(imu_offsets(500), FAST_TURN_RADPS)
    points, t = far_points(100, 50.0)
    off = make_deskewer("off")
    np.testing.assert_array_equal(off.deskew(points, t, knots, np.empty_like(points)), points)
    still = off.effective(knots)
    assert not still.rotation.any()
    assert not still.translation_m.any()
    np.testing.assert_array_equal(still.offsets_ns, [0, 100_000_000])


def test_rotation_removes_the_rotation_only():
    knots = turning(imu_offsets(500), FAST_TURN_RADPS)
    points, t = far_points(100, 50.0)
    back_end = make_deskewer("rotation")
    effective = back_end.effective(knots)
    out = back_end.deskew(points, t, effective, np.empty_like(points))
    turned = Knots(knots.offsets_ns, knots.rotation, 0 * knots.translation_m)
    np.testing.assert_allclose(out, deskew_float64(points.astype(np.float64), t, turned), atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 50.0, atol=1e-3)  # a rotation keeps ranges


def test_auto_is_cpu_where_there_is_no_overlay():
    assert make_deskewer("auto").name == "cpu"
    assert make_image_node(PipelineSettings(), 16, 1800).name == "cpu"


def test_a_back_end_that_is_not_there_is_one_clear_line():
    with pytest.raises(InputError, match="expected one of auto") as error:
        make_deskewer("cuda")
    assert "\n" not in str(error.value)


def test_a_scan_without_points_is_deskewed_to_nothing():
    knots = turning(imu_offsets(500), FAST_TURN_RADPS)
    nothing = np.empty((0, 3), np.float32)
    assert len(make_deskewer("cpu").deskew(nothing, np.empty(0, np.int32), knots, nothing.copy())) == 0
