"""Many poses at once: (n, 4, 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from map_service import _way_kernels as kernels

Array = NDArray[np.float64]


def identities(n: int) -> Array:
    """(n, 4, 4)."""
    return np.tile(np.eye(4), (n, 1, 1))


def inverse(T: Array) -> Array:
    """Of rigid transforms (n, 4, 4)."""
    back = np.zeros_like(T)
    back[:, :3, :3] = T[:, :3, :3].transpose(0, 2, 1)
    back[:, :3, 3:] = -back[:, :3, :3] @ T[:, :3, 3:]
    back[:, 3, 3] = 1.0
    return back


def apart(A: Array, B: Array) -> Array:
    """(n, 6) with B = A moved by it: rotation vector, rad, and shift, m, both in A's own axes."""
    out = np.empty((len(A), 6))
    kernels.apart(A, B, out)
    return out


def moved(A: Array, r: Array) -> Array:
    """(n, 4, 4) = A, each moved by r (n, 6)."""
    out = np.empty((len(r), 4, 4))
    kernels.moved(A, r, out)
    return out
