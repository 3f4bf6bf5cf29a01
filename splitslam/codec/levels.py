"""Sizes as contexts, by table: 0, 1, then two levels an octave."""

from __future__ import annotations

import numpy as np


def level_of(x: int) -> int:
    """Level of x >= 0."""
    if x < 2:
        return x
    e = x.bit_length() - 1
    return 2 * e + ((x >> (e - 1)) & 1)


LEVEL = np.array([level_of(x) for x in range(4096)], np.uint8)
"""LEVEL[x] for x below 4096; ten octaves higher there are 20 levels more."""
