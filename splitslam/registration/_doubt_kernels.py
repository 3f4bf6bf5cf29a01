"""Kernel of the doubt in a scan's place."""

from __future__ import annotations

import numpy as np
from numba import njit

from splitslam._se3_kernels import adjoint, inverse, multiply

FASTMATH = {"contract", "arcp", "nsz"}


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def carried_over(T_local_lidar, poses, covariances, mean):
    """mean (6, 6) of C P C^T with C = Ad(T_local_lidar^-1 pose), over poses (Q, 4, 4) and their P (Q, 6, 6)."""
    back, between = np.empty((4, 4)), np.empty((4, 4))
    carry, half = np.empty((6, 6)), np.empty((6, 6))
    inverse(T_local_lidar, back)
    mean[:] = 0.0
    for q in range(len(poses)):
        multiply(back, poses[q], between)
        adjoint(between, carry)
        for r in range(6):
            for c in range(6):
                half[r, c] = 0.0
                for k in range(6):
                    half[r, c] += carry[r, k] * covariances[q, k, c]
        for r in range(6):
            for c in range(6):
                value = 0.0
                for k in range(6):
                    value += half[r, k] * carry[c, k]
                mean[r, c] += value / len(poses)
