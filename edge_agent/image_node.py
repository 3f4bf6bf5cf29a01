"""The Image node: a scan becomes a range image of deskewed points (paper, Algorithm 1, with Algorithm 2 inside).

One interface, two places where it runs: this processor, or the programmable logic (`edge_agent.deskew.fpga`).
"""

from __future__ import annotations

import logging
from collections import Counter
from typing import Protocol

import numpy as np

from edge_agent.deskew import Deskewer, make_deskewer
from edge_agent.features.integer import FeatureMarks, Limits
from edge_agent.features.projection import Image, Projector
from edge_agent.settings import PipelineSettings
from splitslam.errors import InputError
from splitslam.features import Knots
from splitslam.logs import fields
from splitslam.scan import Scan

_log = logging.getLogger(__name__)


class ImageNode(Protocol):
    """Range image, deskew, and the marks of its points."""

    counts: Counter[str]  # what did not go as it should, by what: for metrics

    @property
    def name(self) -> str:
        """The back end in force, for configuration, metrics and Hello."""
        ...

    def effective(self, knots: Knots) -> Knots:
        """The part of the motion that is removed; these knots travel with the frame."""
        ...

    def image(self, scan: Scan, knots: Knots) -> Image:
        """The scan's image with its points at the scan's reference time. Views that the next scan overwrites."""
        ...

    def marks(self, image: Image) -> FeatureMarks:
        """Curvature, marks and candidates of that image's points."""
        ...

    def close(self) -> None:
        """Gives back what the back end holds."""
        ...


class CpuImageNode:
    """On this processor, with any of its deskew back ends."""

    def __init__(self, deskewer: Deskewer, rings: int, columns: int, limits: Limits) -> None:
        self.counts: Counter[str] = Counter()
        self._deskewer, self._limits = deskewer, limits
        self._project = Projector(rings, columns).project
        cells = rings * columns
        self._moved = np.empty((cells, 3), np.float32)  # in the scan's order, of as many points as came at most
        self._marks = FeatureMarks(np.empty(cells, np.int32), np.empty(cells, np.uint8), np.empty(cells, np.uint8))

    @property
    def name(self) -> str:
        """See ImageNode."""
        return self._deskewer.name

    def effective(self, knots: Knots) -> Knots:
        """See ImageNode."""
        return self._deskewer.effective(knots)

    def image(self, scan: Scan, knots: Knots) -> Image:
        """See ImageNode."""
        if len(self._moved) < len(scan):
            self._moved = np.empty((len(scan), 3), np.float32)
        moved = self._moved[: len(scan)]
        # Algorithm 1, line 15 (equations 1 and 2), while the points are in the order of their times; lines 8-14, 16, 17
        self._deskewer.deskew(scan.points_lidar, scan.t_offset_ns, knots, moved)
        return self._project(scan, moved)

    def marks(self, image: Image) -> FeatureMarks:
        """See ImageNode."""
        assert image.range_q is not None  # the projector's
        return FeatureMarks.of(image.range_q, image.column, image.ring_start, self._limits, self._marks)

    def close(self) -> None:
        """Holds nothing."""


def make_image_node(settings: PipelineSettings, rings: int, columns: int) -> ImageNode:
    """The node for `settings.deskew`; `auto` is the programmable logic where it answers, else `cpu`, and says which.

    InputError for a back end that is unknown or, asked for by name, not here.
    """
    from edge_agent.deskew.fpga import open_accelerated  # brings pynq, where there is one

    limits = Limits.of(settings.features)

    def on_cpu(name: str) -> CpuImageNode:
        return CpuImageNode(make_deskewer(name), rings, columns, limits)

    if settings.deskew in ("fpga", "cosim"):
        return open_accelerated(settings, on_cpu("cpu"), rings, columns)
    if settings.deskew == "auto":
        try:
            node = open_accelerated(settings, on_cpu("cpu"), rings, columns)
        except InputError as error:
            _log.info("deskew chosen", extra=fields(name="cpu", detail=str(error)))
        else:
            _log.info("deskew chosen", extra=fields(name=node.name))
            return node
    return on_cpu(settings.deskew)
