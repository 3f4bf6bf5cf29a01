"""A scan as the accuracy is told of: 28,800 points at 100 m while the robot turns at 217 deg/s and drives at 10 m/s."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_agent.deskew.reference import deskew_float64
from fpga_overlay.golden import packet
from fpga_overlay.golden.fixed import POINT_FRACTION, ROTATION_FRACTION, SLOPE_SHIFT, TRANSLATION_FRACTION
from fpga_overlay.golden.packet import Beats, Header
from fpga_overlay.tb.packets import Packet, Table
from splitslam.features import Knots
from splitslam.motion_table import motion_table

RINGS, COLUMNS = 16, 1800
RANGE_M = 100.0
RATE_RADPS = np.radians(217.0)
SPEED_MPS = 10.0
SPAN_NS = 100_000_000
KNOT_NS = 2_000_000  # an IMU of 500 Hz
TICK_NS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A packet, and where its points belong: (N, 3) m in float64."""

    packet: Packet
    points_start: NDArray[np.float64]

    def error_m(self, answer: Beats) -> NDArray[np.float64]:
        """(N,) distances of the deskewed points in an answer from where they belong."""
        beats = answer[packet.HEADER_BEATS : -packet.TRAILER_BEATS]
        fixed = beats[:, :3].view(np.int32) >> 8
        return np.linalg.norm(fixed / (1 << POINT_FRACTION) - self.points_start, axis=1)


def turning_scan(segment_ns: int = 400_000) -> Scan:
    """The turn is about an axis that lies in none of the planes, so that all nine entries move."""
    times_ns = np.arange(0, SPAN_NS + 1, KNOT_NS)
    axis = np.array([0.3, -0.4, 0.866]) / np.linalg.norm([0.3, -0.4, 0.866])
    seconds = times_ns[:, None] * 1e-9
    travelled = (seconds * SPEED_MPS * np.array([0.9, 0.4, -0.1])).astype(np.float64)
    knots = Knots(times_ns, seconds * RATE_RADPS * axis, travelled)
    table = fixed_table(knots, segment_ns)

    column, ring = np.divmod(np.arange(RINGS * COLUMNS), RINGS)
    azimuth, elevation = 2 * np.pi * column / COLUMNS, np.radians(2.0 * ring - 15.0)
    unit = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], 1)
    points = (RANGE_M * unit).astype(np.float32)
    offset_ns = (np.arange(len(points)) * (SPAN_NS - TICK_NS) // len(points)).astype(np.int32)
    beats = packet.point_beats(points, ring.astype(np.uint8), (offset_ns + TICK_NS // 2) // TICK_NS)
    header = Header(RINGS, COLUMNS, segments=len(table))
    return Scan(Packet(header, table, beats), deskew_float64(points.astype(np.float64), offset_ns, knots))


def fixed_table(knots: Knots, segment_ns: int) -> Table:
    """(S, 28) of the cores from the float table that the CPU reads."""
    floats = motion_table(knots, segment_ns)
    scale = np.array([[1 << ROTATION_FRACTION] * 3 + [1 << TRANSLATION_FRACTION]] * 3).ravel()
    table = np.zeros((len(floats.base), 28), np.int32)
    table[:, 0] = (floats.breaks_ns[:-1] + TICK_NS // 2) // TICK_NS
    table[:, 4:16] = np.round(floats.base.astype(np.float64) * scale)
    table[:, 16:28] = np.round(floats.slope.astype(np.float64) * (scale * (1 << SLOPE_SHIFT) * TICK_NS))
    return table
