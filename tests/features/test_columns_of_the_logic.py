"""The processor finds the columns, ranges and points that the logic finds: fpga_overlay.golden is the judge."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.deskew import make_deskewer
from edge_agent.deskew.fixed_table import fixed_table
from edge_agent.features import _projection_kernels as kernels
from fpga_overlay.golden import cordic, fixed, packet
from fpga_overlay.golden.deskew import deskew
from splitslam.features import Knots
from tests.deskew.motions import FAST_TURN_RADPS, far_points, imu_offsets, turning


@pytest.mark.parametrize("bits", [1, 3, 8, 16, 23])
def test_the_cordic_is_the_logic_s_and_within_its_bound(bits: int) -> None:
    x, y = np.random.default_rng(bits).integers(-(2**bits) + 1, 2**bits, (2, 2000))
    mine = np.array([kernels.cordic_azimuth(a, b) for a, b in zip(x, y, strict=True)])
    np.testing.assert_array_equal(mine, cordic.azimuth(x, y))
    error = mine * 2 * np.pi / 2**27 - np.arctan2(y, x)
    error = np.where((x == 0) & (y == 0), 0, (error + np.pi) % (2 * np.pi) - np.pi)
    assert np.abs(error).max() < 1e-6  # a quarter of what the quick way keeps off the edges


@pytest.mark.parametrize("columns", [2, 36, 1800, 2047, 2048])
@pytest.mark.parametrize("on_the_edges", [False, True])
def test_columns_are_the_logic_s_even_on_the_edges_between_them(columns: int, on_the_edges: bool) -> None:
    rng = np.random.default_rng(columns)
    azimuth = rng.uniform(-np.pi, np.pi, 4000)
    if on_the_edges:
        azimuth = np.pi * (2 * rng.integers(-columns, columns, 4000) + 1) / columns
    r = np.exp(rng.uniform(-7, 6, 4000))
    x, y = (r * np.cos(azimuth)).astype(np.float32), (r * np.sin(azimuth)).astype(np.float32)
    x[:5], y[:5] = [0, 1, -1, 0, -0.0], [0, 0, -0.0, -1, 3]
    mine = [kernels.column_of(a, b, columns) for a, b in zip(x, y, strict=True)]
    steps = fixed.from_float32(x)[0], fixed.from_float32(y)[0]
    np.testing.assert_array_equal(mine, cordic.column_of(cordic.azimuth(*steps), columns))
    quick = np.empty(len(x), np.int32)
    kernels.quick_columns(x, y, columns, quick)
    sure = quick >= 0
    np.testing.assert_array_equal(quick[sure], np.array(mine)[sure])
    usual = (r > 0.26) & (r < 250.0)
    assert np.mean(sure[usual]) > 0.98 or on_the_edges


@pytest.mark.parametrize("rate_hz", [10, 500, 4000])
def test_the_cpu_deskews_to_the_bit_as_the_logic(rate_hz: float) -> None:
    knots = turning(imu_offsets(rate_hz), FAST_TURN_RADPS)
    points, t = far_points(5000, 60.0)
    table = fixed_table(knots, np.empty((256, 28), np.int32))
    tick = t + (1 << table.shift >> 1) >> table.shift
    beats = packet.point_beats(points, np.zeros(len(points), np.uint8), tick)
    by_logic = deskew(packet.Header(16, 1800, len(table.words)), table.words, beats).points
    by_cpu = make_deskewer("cpu").deskew(points, t, knots, np.empty_like(points))
    np.testing.assert_array_equal(by_cpu * 2.0**14, by_logic)


def test_a_motion_beyond_the_fixed_point_is_left_to_the_reference() -> None:
    knots = turning(imu_offsets(100), FAST_TURN_RADPS)
    far = Knots(knots.offsets_ns, knots.rotation, knots.translation_m + 300.0)
    points, t = far_points(50, 60.0)
    out = make_deskewer("cpu").deskew(points, t, far, np.empty_like(points))
    np.testing.assert_array_equal(out, make_deskewer("reference").deskew(points, t, far, np.empty_like(points)))
