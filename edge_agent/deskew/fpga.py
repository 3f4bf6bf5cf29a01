"""The Image node in programmable logic: deskew, projection and marks in one pass, this processor as the spare.

A scan that the logic does not answer is done on the spare and counted; the next one is offered to the logic again.
"""

from __future__ import annotations

import logging
from collections import Counter
from typing import TYPE_CHECKING

from edge_agent.features.integer import FeatureMarks, Limits
from edge_agent.features.projection import Image
from edge_agent.settings import PipelineSettings
from splitslam.errors import InputError
from splitslam.features import Knots
from splitslam.logs import fields
from splitslam.scan import Scan

if TYPE_CHECKING:
    from edge_agent.image_node import CpuImageNode
    from fpga_overlay.driver import Accelerator

_log = logging.getLogger(__name__)


class AcceleratedImageNode:
    """See edge_agent.image_node.ImageNode."""

    def __init__(self, name: str, accelerator: Accelerator, spare: CpuImageNode) -> None:
        self.name, self.counts = name, Counter[str]()
        self._accelerator, self._spare = accelerator, spare
        self._marks: FeatureMarks | None = None

    def effective(self, knots: Knots) -> Knots:
        """All of the motion."""
        return knots

    def image(self, scan: Scan, knots: Knots) -> Image:
        """See ImageNode."""
        from fpga_overlay.driver import AcceleratorError

        try:
            seen = self._accelerator.run(scan, knots)
        except AcceleratorError as error:
            self.counts[error.reason] += 1
            _log.warning("scan deskewed on the cpu", extra=fields(reason=error.reason, detail=str(error)))
            self._marks = None
            return self._spare.image(scan, knots)
        self.counts["unusable_points"] += seen.invalid
        self._marks = seen.marks
        return Image(
            scan=scan,
            points_lidar=seen.points_lidar,
            column=seen.column,
            source=seen.source,
            ring_start=seen.ring_start,
            duplicates=seen.duplicates,
            outside=seen.outside,
        )

    def marks(self, image: Image) -> FeatureMarks:
        """See ImageNode."""
        return self._spare.marks(image) if self._marks is None else self._marks

    def close(self) -> None:
        """Gives back the overlay and its buffers."""
        self._accelerator.close()


def open_accelerated(settings: PipelineSettings, spare: CpuImageNode, rings: int, columns: int) -> AcceleratedImageNode:
    """The logic of this board, or with `cosim` its simulation; self-tested. InputError says why there is none."""
    try:
        from fpga_overlay.driver import Accelerator
    except ImportError as error:
        raise InputError(f"deskew: no overlay driver here ({error})") from None
    limits = Limits.of(settings.features)
    if settings.deskew == "cosim":
        return AcceleratedImageNode("cosim", Accelerator.open_cosim(rings, columns, limits), spare)
    return AcceleratedImageNode("fpga", Accelerator.open(rings, columns, limits, settings.bitstream), spare)
