"""The sensor's own azimuth lattice against the image's columns: how fast the beams drift through the columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.codec import _lattice_kernels as kernels
from splitslam.codec._point_kernels import TURN

_LONGEST = 256  # columns between two points that are compared
_COHERENT = 0.45


def find_drift(
    counts: NDArray[np.int64], points: NDArray[np.int32], fractions: NDArray[np.float64], columns: int
) -> int | None:
    """Drift in 2^-20 columns a column, or None when azimuths within their columns follow no lattice.

    fractions (N,): azimuth within the column, rad. A firing every 0.199 degrees in columns of 0.2 degrees moves by
    -0.005 columns a column; whole columns do not show. It is the frequency at which steps between neighbours add up.
    """
    sums, parts = np.zeros(_LONGEST, np.complex128), np.empty(kernels.BINS, np.complex128)
    pairs = kernels.phase_steps(counts, points, fractions, 2.0 * np.pi / columns, sums)
    if pairs == 0:
        return None
    kernels.spectrum(sums, parts)
    place, size = kernels.strongest(parts)
    if size < _COHERENT * pairs:
        return None
    return round((place - round(place)) * TURN)
