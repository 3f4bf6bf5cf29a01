"""Tables of the logistic function in whole numbers, worked out in whole numbers: the same on every machine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_ONE = 1 << 60
_STEPS = 256  # of the logistic domain to one unit of it


def _powers_of_e() -> list[int]:
    """e^(i / 256) for i = 0 to 2048, times 2^60."""
    term = step = _ONE
    for n in range(1, 20):  # Taylor series of e^(1/256)
        term = term // (n * _STEPS)
        step += term
    powers = [_ONE]
    for _ in range(8 * _STEPS):
        powers.append(powers[-1] * step >> 60)
    return powers


def _tables() -> tuple[NDArray[np.int32], NDArray[np.int16]]:
    powers = _powers_of_e()
    upper = [(65536 * p + (p + _ONE) // 2) // (p + _ONE) for p in powers]
    squash = np.array([65536 - p for p in upper[:0:-1]] + upper, np.int64)
    # the inverse at the middle of each of 4096 probabilities
    stretch = np.searchsorted(squash, 16 * np.arange(4096) + 8).astype(np.int64) - 8 * _STEPS
    return squash.astype(np.int32), np.clip(stretch, -2047, 2047).astype(np.int16)  # small, to stay in the cache


SQUASH, STRETCH = _tables()
"""SQUASH[x + 2048]: 65536 / (1 + e^(-x / 256)); STRETCH[p >> 4]: its inverse for p of 65536."""

RATE = (2 * 65536 // (2 * np.arange(256) + 3)).astype(np.int32)
"""RATE[n]: how far a probability moves towards what it met for the n-th time, 1 / (n + 1.5) of 65536."""
