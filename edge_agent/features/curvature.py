"""Curvature and reliability of the image's points (LOAM, section V-A, in LIO-SAM's form)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_agent.features import _kernels as kernels
from edge_agent.features.projection import Image


@dataclass(frozen=True, slots=True, eq=False)
class Smoothness:
    """Per point of an image; views that the next scan overwrites.

    curvature: (M,) float32, m^2, not normalised, from raw ranges. masked: (M,) uint8, 1: occluded or parallel beam.
    """

    curvature: NDArray[np.float32]
    masked: NDArray[np.uint8]


class SmoothnessFilter:
    """Computes Smoothness into buffers for up to `cells` points."""

    def __init__(self, cells: int) -> None:
        self._curvature = np.empty(cells, np.float32)
        self._masked = np.empty(cells, np.uint8)

    def __call__(self, image: Image) -> Smoothness:
        """Curvature and mask of every point."""
        n = len(image)
        result = Smoothness(self._curvature[:n], self._masked[:n])
        kernels.smoothness(image.range_m, result.curvature)
        kernels.unreliable(image.range_m, image.column, result.masked)
        return result
