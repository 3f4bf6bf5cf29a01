"""Twins of the driver's kernels, one element at a time."""

from __future__ import annotations

import numpy as np

from fpga_overlay.golden.packet import Beats


def unpack_point(beat: np.ndarray) -> tuple[list[float], int, int, int, int]:
    """Point in m, ring, column, flags and range of a point as the logic sends it."""
    x, y, z, range_q = map(int, beat)
    signed = [(w >> 8) - (1 << 24 if w >> 31 else 0) for w in (x, y, z)]
    return [v / 2**14 for v in signed], x & 255, (z & 15) << 8 | y & 255, z >> 4 & 15, range_q


def ordered(beats: Beats) -> list[int]:
    """Indices of the valid points by ring and column, the first of a cell wins."""
    first: dict[tuple[int, int], int] = {}
    for i, beat in enumerate(beats):
        _, ring, column, flags, _ = unpack_point(beat)
        if flags & 1:
            first.setdefault((ring, column), i)
    return [first[cell] for cell in sorted(first)]
