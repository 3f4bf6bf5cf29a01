"""Rigid transforms (4, 4) for kernels that would else have to come back for a few small products.

Conventions and formulas are those of splitslam.se3, which is also their twin in the tests. No output may be an input.
"""

from __future__ import annotations

import math

from numba import njit

from splitslam._motion_kernels import rotation_from_vector, vector_of

FASTMATH = {"contract", "arcp", "nsz"}


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def multiply(A, B, out):
    """out = A B."""
    for r in range(3):
        for c in range(4):
            value = A[r, 3] if c == 3 else 0.0
            for k in range(3):
                value += A[r, k] * B[k, c]
            out[r, c] = value
    out[3, 0], out[3, 1], out[3, 2], out[3, 3] = 0.0, 0.0, 0.0, 1.0


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def inverse(T, out):
    """out = T^-1."""
    for r in range(3):
        value = 0.0
        for c in range(3):
            out[r, c] = T[c, r]
            value -= T[c, r] * T[c, 3]
        out[r, 3] = value
    out[3, 0], out[3, 1], out[3, 2], out[3, 3] = 0.0, 0.0, 0.0, 1.0


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def exp(xi, out):
    """out = exp of a tangent (6,)."""
    x, y, z, tx, ty, tz = xi[0], xi[1], xi[2], xi[3], xi[4], xi[5]
    square = x * x + y * y + z * z
    if square < 1e-8:
        b, c = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        theta = math.sqrt(square)
        half = math.sin(0.5 * theta) / theta
        b, c = 2.0 * half * half, (theta - math.sin(theta)) / (square * theta)
    # V t = t + b w x t + c w x (w x t)
    ox, oy, oz = y * tz - z * ty, z * tx - x * tz, x * ty - y * tx
    rotation_from_vector(x, y, z, out)
    out[0, 3] = tx + b * ox + c * (y * oz - z * oy)
    out[1, 3] = ty + b * oy + c * (z * ox - x * oz)
    out[2, 3] = tz + b * oz + c * (x * oy - y * ox)
    out[3, 0], out[3, 1], out[3, 2], out[3, 3] = 0.0, 0.0, 0.0, 1.0


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def log(T, xi):
    """xi (6,) = the tangent of T."""
    vector_of(T, xi)
    x, y, z, tx, ty, tz = xi[0], xi[1], xi[2], T[0, 3], T[1, 3], T[2, 3]
    square = x * x + y * y + z * z
    half = 0.5 * math.sqrt(square)
    c = 1.0 / 12.0 + square / 720.0 if half < 1e-3 else (1.0 - half / math.tan(half)) / square
    # V^-1 t = t - w x t / 2 + c w x (w x t)
    ox, oy, oz = y * tz - z * ty, z * tx - x * tz, x * ty - y * tx
    xi[3] = tx - 0.5 * ox + c * (y * oz - z * oy)
    xi[4] = ty - 0.5 * oy + c * (z * ox - x * oz)
    xi[5] = tz - 0.5 * oz + c * (x * oy - y * ox)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def adjoint(T, out):
    """out (6, 6) with exp(out xi) = T exp(xi) T^-1."""
    for r in range(3):
        i, j = (r + 1) % 3, (r + 2) % 3
        for c in range(3):
            out[r, c] = out[3 + r, 3 + c] = T[r, c]
            out[r, 3 + c] = 0.0
            out[3 + r, c] = T[i, 3] * T[j, c] - T[j, 3] * T[i, c]
