"""A scan into a packet to the logic, written in place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge_agent.deskew.fixed_table import FixedTable, fixed_table
from edge_agent.features.integer import Limits
from fpga_overlay.driver import _kernels as kernels
from fpga_overlay.driver.errors import AcceleratorError
from fpga_overlay.golden.packet import HEADER_BEATS, MAX_SEGMENTS, SEGMENT_BEATS, Beats, Header
from splitslam.features import Knots
from splitslam.scan import Scan

ROOM_BEATS = HEADER_BEATS + MAX_SEGMENTS * SEGMENT_BEATS  # before the points, at most


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """A packet, (B, 4) uint32, and what it says; views of the buffer it was written into."""

    beats: Beats
    header: Header
    table: FixedTable

    @property
    def points(self) -> Beats:
        """(N, 4) uint32."""
        return self.beats[HEADER_BEATS + len(self.table.words) * SEGMENT_BEATS :]


class RequestWriter:
    """Writes the packets of one sensor."""

    def __init__(self, rings: int, columns: int, limits: Limits, flags: int = 0) -> None:
        """flags: golden.packet.BYPASS_*."""
        self._of_sensor = {
            "rings": rings,
            "columns": columns,
            "flags": flags,
            "sectors": limits.sectors,
            "occlusion": limits.occlusion,
            "corner": limits.corner,
            "flat": limits.flat,
        }

    def write(self, scan: Scan, knots: Knots, sequence: int, out: Beats) -> Request:
        """Header, table and points into `out`, (ROOM_BEATS + N or more, 4) uint32.

        AcceleratorError (`motion`): beyond 2 of rotation or 256 m.
        """
        words = out[HEADER_BEATS:ROOM_BEATS].view(np.int32).reshape(MAX_SEGMENTS, SEGMENT_BEATS * 4)
        table = fixed_table(knots, words)
        if not table.fits:
            raise AcceleratorError("motion", "it does not fit the table's fixed point")
        header = Header(segments=len(table.words), sequence=sequence, **self._of_sensor)
        out[:HEADER_BEATS] = header.beats()
        first = HEADER_BEATS + len(table.words) * SEGMENT_BEATS
        end = first + len(scan)
        bits = np.ascontiguousarray(scan.points_lidar).view(np.uint32)
        kernels.pack_points(bits, scan.t_offset_ns, scan.ring, table.shift, out[first:end])
        return Request(out[:end], header, table)
