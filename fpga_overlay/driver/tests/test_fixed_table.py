from __future__ import annotations

import numpy as np
import pytest

from edge_agent.deskew.fixed_table import fixed_table
from edge_agent.deskew.reference import deskew_float64
from edge_agent.features.integer import Limits
from fpga_overlay.driver.errors import AcceleratorError
from fpga_overlay.driver.request import RequestWriter
from fpga_overlay.driver.self_test import made_scan
from fpga_overlay.golden import packet
from fpga_overlay.golden.deskew import deskew
from splitslam.features import Knots
from tests.deskew.motions import FAST_TURN_RADPS, far_points, imu_offsets, turning
from tests.tolerances import DESKEW_FPGA_M, DESKEW_RANGE_M


def deskewed(knots: Knots, points: np.ndarray, t_ns: np.ndarray) -> np.ndarray:
    """(N, 3) m, as the logic does it."""
    table = fixed_table(knots, np.empty((256, 28), np.int32))
    tick = t_ns + (1 << table.shift >> 1) >> table.shift
    beats = packet.point_beats(points, np.zeros(len(points), np.uint8), tick)
    header = packet.Header(16, 1800, len(table.words))
    return deskew(header, table.words, beats).points / 2.0**14


@pytest.mark.parametrize("rate_hz", [10, 50, 97, 100, 200, 250, 333, 500, 700, 900, 1000, 1700, 2000, 2600, 4000])
@pytest.mark.parametrize("phase", [0.3, np.pi / 2])
def test_within_half_a_millimetre_of_float64_at_100_m_and_217_deg_per_s(rate_hz: float, phase: float) -> None:
    knots = turning(imu_offsets(rate_hz), FAST_TURN_RADPS, phase=phase)
    points, t = far_points(4000, DESKEW_RANGE_M)
    error = np.linalg.norm(deskewed(knots, points, t) - deskew_float64(points.astype(np.float64), t, knots), axis=1)
    assert error.max() <= DESKEW_FPGA_M
    assert np.linalg.norm(deskewed(knots, points, t) - points, axis=1).max() > 5.0


@pytest.mark.parametrize("scan_ms", [50, 100, 200, 1000])
def test_firings_of_a_velodyne_lie_on_the_tick_grid_in_scans_of_any_usual_length(scan_ms: int) -> None:
    table = fixed_table(turning(imu_offsets(200, scan_ms * 1_000_000), 0.1), np.empty((256, 28), np.int32))
    assert 2304 % (1 << table.shift) == 0
    assert table.words[-1, 0] == scan_ms * 1_000_000 >> table.shift < 1 << 24
    assert np.diff(table.words[:, 0]).max() < 1 << 17


def test_before_the_first_and_after_the_last_knot_the_pose_is_held() -> None:
    knots = turning(np.array([10_000_000, 40_000_000, 90_000_000]), FAST_TURN_RADPS)
    p = np.tile(np.array([[30.0, 5.0, 1.0]], np.float32), (4, 1))
    out = deskewed(knots, p, np.array([0, 10_000_000, 90_000_000, 100_000_000], np.int32))
    np.testing.assert_array_equal(out[0], out[1])
    np.testing.assert_array_equal(out[2], out[3])
    np.testing.assert_allclose(
        out[::2],
        deskew_float64(p[::2].astype(np.float64), np.array([0, 90_000_000], np.int32), knots),
        atol=DESKEW_FPGA_M,
    )
    assert np.linalg.norm(out[1] - out[2]) > 1.0


def test_irregular_knots_are_resampled_evenly_and_stay_true() -> None:
    """A hole of 30 ms in an IMU of 2 kHz, and jitter."""
    rng = np.random.default_rng(3)
    offsets = imu_offsets(2000)
    offsets = offsets[(offsets < 40_000_000) | (offsets > 70_000_000)]
    offsets[1:-1] += rng.integers(-150_000, 150_000, len(offsets) - 2)
    knots = turning(np.sort(offsets), FAST_TURN_RADPS, phase=np.pi / 2)
    points, t = far_points(4000, DESKEW_RANGE_M)
    error = np.linalg.norm(deskewed(knots, points, t) - deskew_float64(points.astype(np.float64), t, knots), axis=1)
    assert error.max() <= DESKEW_FPGA_M


@pytest.mark.parametrize("last_ns", [1, 1000, 2**31 - 1, 60_000_000_000])
def test_scans_of_any_length_fit_the_table(last_ns: int) -> None:
    knots = turning(np.array([0, last_ns]), 1e-5)
    table = fixed_table(knots, np.empty((256, 28), np.int32))
    assert 2 <= len(table.words) <= 256
    assert 0 <= table.words[:, 0].min() <= table.words[:, 0].max() < 1 << 24
    assert np.diff(table.words[:, 0]).max() < 1 << 17


def test_knots_that_end_before_the_scan_begins_hold_their_last_pose() -> None:
    knots = turning(np.array([-20_000_000, -10_000_000]), FAST_TURN_RADPS)
    p = np.tile(np.array([[30.0, 5.0, 1.0]], np.float32), (2, 1))
    out = deskewed(knots, p, np.array([0, 50_000_000], np.int32))
    np.testing.assert_allclose(
        out, deskew_float64(p.astype(np.float64), np.zeros(2, np.int32), knots), atol=DESKEW_FPGA_M
    )


def test_a_motion_that_cannot_be_is_refused_by_the_logic() -> None:
    knots = turning(imu_offsets(200), FAST_TURN_RADPS)
    far = Knots(knots.offsets_ns, knots.rotation, knots.translation_m + 300.0)
    assert not fixed_table(far, np.empty((256, 28), np.int32)).fits
    writer = RequestWriter(16, 1800, Limits(307, 1024, 324, 6))
    with pytest.raises(AcceleratorError, match="fixed point") as error:
        writer.write(made_scan(16), far, 1, np.empty((10_000, 4), np.uint32))
    assert error.value.reason == "motion"
