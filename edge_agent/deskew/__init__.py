"""Deskew: every point moved to where it would have been seen from at the scan's reference time.

One interface, several back ends; `reference` defines what is right, the others are held to it.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from edge_agent.deskew.cpu import CpuDeskewer, OffDeskewer, RotationDeskewer
from edge_agent.deskew.reference import ReferenceDeskewer
from splitslam.errors import InputError
from splitslam.features import Knots

BACK_ENDS = ("auto", "reference", "cpu", "fpga", "cosim", "off", "rotation")


class Deskewer(Protocol):
    """A deskew back end."""

    @property
    def name(self) -> str:
        """What the back end is called in configuration, metrics and Hello."""
        ...

    def effective(self, knots: Knots) -> Knots:
        """The part of the motion that this back end removes; these knots travel with the frame."""
        ...

    def deskew(
        self,
        points_lidar: NDArray[np.float32],
        t_offset_ns: NDArray[np.int32],
        knots: Knots,
        out: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """Writes T_start_lidar(t) @ p for every point into `out` and returns it.

        points_lidar, out: (N, 3) float32, C-contiguous, m, frame `lidar` at the point's own time and at the scan's
        reference time. t_offset_ns: (N,) int32 after the reference time. Points outside the knots take the end knot.
        """
        ...


def make_deskewer(name: str) -> Deskewer:
    """The back end of that name on this processor; `auto` is `cpu`. InputError for one that is unknown.

    The programmable logic does more than deskew: `edge_agent.image_node.make_image_node`.
    """
    match name:
        case "auto" | "cpu":
            return CpuDeskewer()
        case "reference":
            return ReferenceDeskewer()
        case "rotation":
            return RotationDeskewer()
        case "off":
            return OffDeskewer()
    raise InputError(f"deskew: {name!r} is no back end; expected one of {', '.join(BACK_ENDS)}")
