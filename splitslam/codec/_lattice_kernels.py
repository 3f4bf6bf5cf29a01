"""Kernels that find how fast a sensor's beams drift through the image's columns."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam.codec._point_kernels import COLUMN

FASTMATH = {"contract", "nsz"}
BINS = 1024
_ANGLES = [2.0 * math.pi * i / BINS for i in range(BINS // 2)]
_TURNS = np.array([complex(math.cos(angle), -math.sin(angle)) for angle in _ANGLES])
_REVERSED = np.array([int(f"{i:010b}"[::-1], 2) for i in range(BINS)])


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def phase_steps(counts, points, fractions, column_rad, sums):
    """sums (L,) complex128: e^(2 pi i change of the azimuth within the column) of points so many columns apart.

    Returns how many pairs there are: each point and the four before it in its ring. Fractions of 9 are left out.
    """
    phases, last = np.empty(len(fractions), np.complex128), np.int64(len(sums))
    for i in range(len(fractions)):
        angle = 2.0 * math.pi / column_rad * fractions[i]
        phases[i] = complex(math.cos(angle), math.sin(angle)) if fractions[i] < 1.0 else 0.0
    pairs, i = 0, 0
    for r in range(len(counts)):
        for n in range(counts[r]):
            for k in range(1, min(n, 4) + 1):
                gap = np.int64(points[COLUMN, i]) - np.int64(points[COLUMN, i - k])
                if gap >= last:
                    break
                if fractions[i] < 1.0 and fractions[i - k] < 1.0:
                    sums[gap] += phases[i] * phases[i - k].conjugate()
                    pairs += 1
            i += 1
    return pairs


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def spectrum(values, parts):
    """parts (BINS,) complex128: the discrete Fourier transform of values (L,) complex128, L <= BINS, with zeros behind.

    Cooley and Tukey, An algorithm for the machine calculation of complex Fourier series, 1965. A frame needs one of a
    thousand bins: the way to a library's and back takes longer.
    """
    n = len(parts)
    for i in range(n):
        parts[i] = values[_REVERSED[i]] if _REVERSED[i] < len(values) else 0.0
    half = 1
    while half < n:
        for first in range(0, n, 2 * half):
            for k in range(half):
                a, b = parts[first + k], parts[first + half + k] * _TURNS[k * (n // (2 * half))]
                parts[first + k], parts[first + half + k] = a + b, a - b
        half *= 2


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def strongest(parts):
    """(place of the largest real part, from 0 to 1, between bins by a parabola; its size) of parts (B,)."""
    peak = 0
    for k in range(len(parts)):
        if parts[k].real > parts[peak].real:
            peak = k
    here = parts[peak].real
    left, right = parts[peak - 1].real, parts[(peak + 1) % len(parts)].real
    bend = left - 2.0 * here + right
    return (peak + (0.5 * (left - right) / bend if bend < 0 else 0.0)) / len(parts), here
