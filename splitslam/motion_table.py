"""Motion inside a scan as a table of short affine segments: what every fast deskew reads.

The knots of a scan are too far apart for linear matrices (a chord cuts the arc) and slerp per point is slow; between
lies a table that divides each knot interval into pieces of at most 0.4 ms. A chord then errs by (rate x 0.4 ms)^2 / 8:
0.03 mm at 217 deg/s and 100 m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam import _motion_kernels as kernels
from splitslam.features import Knots

_SEGMENT_NS = 400_000
_MAX_SEGMENTS = 4096


@dataclass(frozen=True, slots=True, eq=False)
class MotionTable:
    """T_start_lidar(t) = base[s] + slope[s] * (t - breaks_ns[s]) for breaks_ns[s] <= t < breaks_ns[s + 1].

    breaks_ns: (S + 1,) int64 after the scan's stamp; base, slope: (S, 12) float32, row-major 3x4, m and per ns.
    Before the first and after the last break the pose of that break is held.
    """

    breaks_ns: NDArray[np.int64]
    base: NDArray[np.float32]
    slope: NDArray[np.float32]


def motion_table(knots: Knots, segment_ns: int = _SEGMENT_NS) -> MotionTable:
    """Cuts every knot interval into segments of at most `segment_ns` (and all into at most 4096)."""
    parts = np.empty(len(knots.offsets_ns) - 1, np.int64)
    count = kernels.count_segments(knots.offsets_ns, segment_ns, _MAX_SEGMENTS, parts)
    breaks = np.empty(count + 1, np.int64)
    base, slope = np.empty((count, 12), np.float32), np.empty((count, 12), np.float32)
    kernels.fill_segments(knots.offsets_ns, knots.rotation, knots.translation_m, parts, breaks, base, slope)
    return MotionTable(breaks, base, slope)
