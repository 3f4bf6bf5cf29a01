"""Deskew back end `cpu`: a table of matrices resampled once per scan, one affine map per point, all in fixed point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge_agent.deskew._kernels import deskew_points
from edge_agent.deskew.fixed_table import MOST_SEGMENTS, WORDS, fixed_table
from edge_agent.deskew.reference import deskew_float64
from splitslam.features import Knots


class CpuDeskewer:
    """To the bit what the programmable logic does; within 0.2 mm of the reference at 100 m and 217 deg/s."""

    name = "cpu"

    def __init__(self) -> None:
        self._words = np.empty((MOST_SEGMENTS, WORDS), np.int32)

    def effective(self, knots: Knots) -> Knots:
        """The motion this back end removes: all of it."""
        return knots

    def deskew(
        self,
        points_lidar: NDArray[np.float32],
        t_offset_ns: NDArray[np.int32],
        knots: Knots,
        out: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """See edge_agent.deskew.Deskewer."""
        table = fixed_table(knots, self._words)
        if table.fits:
            deskew_points(points_lidar, t_offset_ns, table.shift, table.words, out)
        else:
            out[:] = deskew_float64(points_lidar.astype(np.float64), t_offset_ns, knots)
        return out


class RotationDeskewer(CpuDeskewer):
    """LIO-SAM as shipped: rotation only, for experiments."""

    name = "rotation"

    def effective(self, knots: Knots) -> Knots:
        """The motion without its translation."""
        return Knots(knots.offsets_ns, knots.rotation, np.zeros_like(knots.translation_m))


class OffDeskewer:
    """No deskew at all: the negative control."""

    name = "off"

    def effective(self, knots: Knots) -> Knots:
        """No motion, over the same time."""
        zero = np.zeros((2, 3))
        return Knots(knots.offsets_ns[[0, -1]], zero, zero)

    def deskew(
        self,
        points_lidar: NDArray[np.float32],
        t_offset_ns: NDArray[np.int32],
        knots: Knots,
        out: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """Copies the points."""
        out[:] = points_lidar
        return out
