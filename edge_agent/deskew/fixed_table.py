"""The motion of one scan in fixed point: a table of short segments, each on a tick, for processor and logic alike.

The logic's words are those of fpga_overlay/golden/packet.py: 28 a segment, the first tick, three of padding, the base's
3x4 and the slope's, row-major.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_agent.deskew import _kernels as kernels
from splitslam.features import Knots

MOST_SEGMENTS, WORDS = 256, 28
SEGMENT_NS = 400_000  # a chord then errs by 0.03 mm at 217 deg/s and 100 m
_TICK_BITS, _DT_BITS = 24, 17
_LAST_NS = 2**31 - 1  # no point is later
_ROTATION, _TRANSLATION = float(1 << 25), float(1 << 18)  # units of 1 and of 1 m
SCALE = np.array(([_ROTATION] * 3 + [_TRANSLATION]) * 3)


@dataclass(frozen=True, slots=True, eq=False)
class FixedTable:
    """words: (S, 28) int32, 1 <= S <= 256; the last segment holds. A tick is 2^shift ns.

    fits: False where the motion is beyond 2 of rotation or 256 m, and the table is not to be used.
    """

    words: NDArray[np.int32]
    shift: int
    fits: bool


def fixed_table(knots: Knots, words: NDArray[np.int32]) -> FixedTable:
    """Resamples the knots into `words`, (256, 28) int32, which the table is a view of.

    Breaks lie on the knots where these are even enough, so that no chord cuts a corner of the motion. Before the first
    knot and after the last one the pose is held.
    """
    breaks = np.empty(MOST_SEGMENTS, np.int64)
    last_ns = min(max(int(knots.offsets_ns[-1]), 0), _LAST_NS)
    breaks = breaks[: kernels.lay_breaks(knots.offsets_ns, last_ns, SEGMENT_NS, breaks)]
    shift = _tick_shift(last_ns, kernels.longest(breaks))
    table = words[: len(breaks)]
    fits = kernels.fill_table(knots.offsets_ns, knots.rotation, knots.translation_m, breaks, shift, SCALE, table)
    return FixedTable(table, shift, fits)


def _tick_shift(last_ns: int, longest_ns: int) -> int:
    """The finest tick, a power of two ns, on which the last break has 24 bits and the longest segment 17.

    Up to 256 ns it divides 2,304 ns: the firings of a Velodyne then lie on it exactly, in scans of up to 4 s.
    """
    shift = 0
    while last_ns + (1 << shift) >> shift >= 1 << _TICK_BITS or (longest_ns >> shift) + 1 >= 1 << _DT_BITS:
        shift += 1
    return shift
