"""Tables of the logistic function in whole numbers, worked out in whole numbers: the same on every machine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_ONE = 1 << 60
_STEPS = 256  # of the logistic domain to one unit of it
_LEAST = 48  # of 65536: no bit is ever certain


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


def _squash() -> NDArray[np.int32]:
    upper = [(65536 * p + (p + _ONE) // 2) // (p + _ONE) for p in _powers_of_e()]
    chances = np.array([65536 - p for p in upper[:0:-1]] + upper, np.int32)
    return np.clip(chances, _LEAST, 65536 - _LEAST)


SQUASH = _squash()
"""SQUASH[x + 2048]: 65536 / (1 + e^(-x / 256)), within 48 of 0 and 65536; x from -2048 to 2048."""

RATE = (3 * 65536 // (8 + np.arange(64)) + 2_000).astype(np.int32)
"""RATE[n]: how far the odds of a context that was met n times move by an error of one, 2^-16."""
