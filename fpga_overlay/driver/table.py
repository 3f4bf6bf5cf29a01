"""The motion of one scan as the logic reads it: a fixed-point table of short segments, each on a tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpga_overlay.driver import _kernels as kernels
from fpga_overlay.driver.errors import AcceleratorError
from fpga_overlay.golden import fixed, packet
from splitslam.features import Knots

SEGMENT_NS = 400_000  # as for the cpu back end: a chord then errs by 0.03 mm at 217 deg/s and 100 m
_TICK_BITS = 24
_LAST_NS = 2**31 - 1  # no point is later
_ROTATION, _TRANSLATION = float(1 << fixed.ROTATION_FRACTION), float(1 << fixed.TRANSLATION_FRACTION)
_SCALE = np.array(([_ROTATION] * 3 + [_TRANSLATION]) * 3)


@dataclass(frozen=True, slots=True, eq=False)
class FixedTable:
    """words: (S, 28) int32, 1 <= S <= 256, as in golden/packet.py; the last segment holds. A tick is 2^shift ns."""

    words: NDArray[np.int32]
    shift: int


def fixed_table(knots: Knots, words: NDArray[np.int32]) -> FixedTable:
    """Resamples the knots into `words`, (256, 28) int32, which the table is a view of.

    Breaks lie on the knots where these are even enough, so that no chord cuts a corner of the motion. Before the first
    knot and after the last one the pose is held. AcceleratorError (`motion`): beyond 2 of rotation or 256 m.
    """
    breaks = np.empty(packet.MAX_SEGMENTS, np.int64)
    last_ns = min(max(int(knots.offsets_ns[-1]), 0), _LAST_NS)
    breaks = breaks[: kernels.lay_breaks(knots.offsets_ns, last_ns, SEGMENT_NS, breaks)]
    shift = _tick_shift(last_ns, int(np.diff(breaks).max(initial=0)))
    table = words[: len(breaks)]
    if not kernels.fill_table(knots.offsets_ns, knots.rotation, knots.translation_m, breaks, shift, _SCALE, table):
        raise AcceleratorError("motion", "it does not fit the table's fixed point")
    return FixedTable(table, shift)


def _tick_shift(last_ns: int, longest_ns: int) -> int:
    """The finest tick, a power of two ns, on which the last break has 24 bits and the longest segment 17.

    Up to 256 ns it divides 2,304 ns: the firings of a Velodyne then lie on it exactly, in scans of up to 4 s.
    """
    shift = 0
    while last_ns + (1 << shift) >> shift >= 1 << _TICK_BITS or (longest_ns >> shift) + 1 >= 1 << fixed.DT_BITS:
        shift += 1
    return shift
