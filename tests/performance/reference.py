"""What kernels are held against: arithmetic in a stream, decisions that wait for each other, look-ups out of order.

Never to be made faster or slower: then every bound changes.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_POINTS, _STEPS = 12_000, 12_000
_TABLE = 1 << 12  # 32 kB: stays in the first cache, whatever runs between


class Reference:
    """A little of each, on arrays of its own; some 0.1 ms here."""

    def __init__(self) -> None:
        rng = np.random.default_rng(1)
        self._points = rng.normal(size=(_POINTS, 3)).astype(np.float32)
        self._table = rng.integers(0, _TABLE, _TABLE).astype(np.int64)
        self._out = np.empty((_POINTS, 3), np.float32)
        self()  # compiles

    def __call__(self) -> float:
        """The sum of all results, so that none can be left out."""
        return stream(self._points, self._out) + decide(self._table, _STEPS) + wander(self._table, _STEPS)


@njit(cache=True, nogil=True)
def stream(points, out):
    """Points (N, 3) float32 turned, moved and measured."""
    total = 0.0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        out[i, 0] = 0.8 * x - 0.6 * y + 1.0
        out[i, 1] = 0.6 * x + 0.8 * y - 2.0
        out[i, 2] = z + 0.5
        total += np.sqrt(x * x + y * y + z * z)
    return total


@njit(cache=True, nogil=True)
def decide(table, steps):
    """As an entropy coder goes: each step's branch depends on the state that the step before has left."""
    state, ones = np.int64(1), 0
    for i in range(steps):
        state = (state * 6364136223846793005 + table[i & 1023]) & 0x7FFFFFFFFFFF
        if (state >> 20) & 1:
            ones += 1
            state ^= state >> 7
        elif state & 64:
            state += ones
    return float(ones)


@njit(cache=True, nogil=True)
def wander(table, steps):
    """As a hash table is read: the next place is known when this one has been."""
    at = np.int64(0)
    for _ in range(steps):
        at = (table[at] + 7919) & (len(table) - 1)
    return float(at)
