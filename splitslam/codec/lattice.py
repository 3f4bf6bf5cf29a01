"""The sensor's own azimuth lattice against the image's columns: how fast the beams drift through the columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.codec import _beam_kernels as kernels
from splitslam.codec._point_kernels import TURN

_LONGEST = 1024  # columns between two points that are compared
_BINS = 4096
_COHERENT = 0.45


def find_drift(
    counts: NDArray[np.int64], points: NDArray[np.int32], fractions: NDArray[np.float64], columns: int
) -> int | None:
    """Drift in 2^-20 columns a column, or None when azimuths within their columns follow no lattice.

    fractions (N,): azimuth within the column, rad. A firing every 0.199 degrees in columns of 0.2 degrees moves by
    -0.005 columns a column; whole columns do not show. It is the frequency at which steps between neighbours add up.
    """
    sums = np.zeros(_LONGEST, np.complex128)
    pairs = kernels.phase_steps(counts, points, fractions, 2.0 * np.pi / columns, sums)
    if pairs == 0:
        return None
    spectrum = np.fft.fft(sums, _BINS).real
    peak = int(np.argmax(spectrum))
    if spectrum[peak] < _COHERENT * pairs:
        return None
    left, here, right = spectrum[peak - 1], spectrum[peak], spectrum[(peak + 1) % _BINS]
    bend = left - 2.0 * here + right
    place = (peak + (0.5 * (left - right) / bend if bend < 0 else 0.0)) / _BINS
    return round((place - round(place)) * TURN)
