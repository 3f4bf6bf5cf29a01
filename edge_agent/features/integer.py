"""Curvature, marks and candidates of a range image, in integers: the CPU and the programmable logic agree to the bit.

LOAM, section V-A, in LIO-SAM's form, ring by ring: no window reaches into another ring.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_agent.features import _kernels as kernels
from edge_agent.settings import FeatureSettings

RANGE_UNITS_PER_M = 1024
RANGE_MAX = (1 << 18) - 1  # saturated: 256 m and beyond
MASKED, CORNER, FLAT = 1, 2, 4
NO_SECTOR = 7
MOST_SECTORS = 7
_OCCLUSION_M = 0.3


@dataclass(frozen=True, slots=True)
class Limits:
    """Thresholds in range units (1/1024 m): a corner candidate has |d| > corner, a flat point |d| < flat."""

    occlusion: int
    corner: int
    flat: int
    sectors: int

    @classmethod
    def of(cls, settings: FeatureSettings) -> Limits:
        """The settings' thresholds, which are of d^2 in m^2, as ones of |d| that no integer tells apart from them."""
        corner = math.floor(RANGE_UNITS_PER_M * math.sqrt(settings.corner_threshold_m2))
        flat = math.ceil(RANGE_UNITS_PER_M * math.sqrt(settings.surf_threshold_m2))
        return cls(round(_OCCLUSION_M * RANGE_UNITS_PER_M), corner, flat, settings.sectors)


@dataclass(frozen=True, slots=True, eq=False)
class FeatureMarks:
    """Per point of an image, ordered by ring and column.

    d: (M,) int32, |sum of the ten neighbours' ranges - 10 range|, 1/1024 m; 0 within 5 of the ring's ends.
    marks: (M,) uint8, MASKED (occluded or parallel beam) | CORNER | FLAT candidate. sector: (M,) uint8, NO_SECTOR for
    the 5 points before and 6 after a ring's sectors.
    """

    d: NDArray[np.int32]
    marks: NDArray[np.uint8]
    sector: NDArray[np.uint8]

    @classmethod
    def of(
        cls,
        range_q: NDArray[np.int32],
        column: NDArray[np.uint16],
        ring_start: NDArray[np.int32],
        limits: Limits,
        out: FeatureMarks | None = None,
    ) -> FeatureMarks:
        """range_q: (M,) 1/1024 m, 1 to RANGE_MAX. ring_start: (rings + 1,). `out` holds at least M points."""
        n = len(range_q)
        if out is None:
            out = cls(np.empty(n, np.int32), np.empty(n, np.uint8), np.empty(n, np.uint8))
        found = cls(out.d[:n], out.marks[:n], out.sector[:n])
        kernels.differences(range_q, ring_start, found.d)
        kernels.unreliable(range_q, column, ring_start, limits.occlusion, found.marks)
        kernels.candidates(found.d, ring_start, limits.corner, limits.flat, limits.sectors, found.marks, found.sector)
        return found
