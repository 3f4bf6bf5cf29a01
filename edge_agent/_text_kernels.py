"""Poses as lines of text: an IMU's rate makes of a few microseconds a line a good part of a core."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from edge_agent.imu._kernels import quaternion

LONGEST_LINE = 2 * 20 + 8 * 22  # two whole numbers, seven numbers with their signs and decimals
_NINE = 1_000_000_000


@njit(cache=True, nogil=True)
def put_whole(value, digits, text, at):
    """Writes value >= 0, with zeros in front to `digits` of them at least, to text[at:]; returns where it ends."""
    count, rest = 1, value // 10
    while rest > 0:
        count, rest = count + 1, rest // 10
    end = at + max(count, digits)
    for k in range(end - 1, at - 1, -1):
        text[k] = 48 + value % 10
        value //= 10
    return end


@njit(cache=True, nogil=True)
def tum_lines(stamps_ns, positions_m, quats_xyzw, text):
    """Fills text (bytes, uint8, LONGEST_LINE a pose) with TUM lines of nine decimals; returns how many bytes.

    stamps_ns (M,) int64 >= 0; positions_m (M, 3), below 9e9; quats_xyzw (M, 4).
    """
    n = 0
    for k in range(len(stamps_ns)):
        n = put_whole(stamps_ns[k] // _NINE, 1, text, n)
        text[n] = 46  # .
        n = put_whole(stamps_ns[k] % _NINE, 9, text, n + 1)
        for c in range(7):
            value = positions_m[k, c] if c < 3 else quats_xyzw[k, c - 3]
            text[n] = 32
            n += 1
            if math.copysign(1.0, value) < 0.0:
                text[n] = 45  # -
                n += 1
            whole = np.int64(np.rint(abs(value) * 1e9))
            n = put_whole(whole // _NINE, 1, text, n)
            text[n] = 46
            n = put_whole(whole % _NINE, 9, text, n + 1)
        text[n] = 10
        n += 1
    return n


@njit(cache=True, nogil=True)
def moved_lines(stamps_ns, positions_m, quats_xyzw, T, text):
    """`tum_lines` of the poses T @ pose; T (4, 4) rigid. Hamilton product, T's quaternion by Shepperd's method."""
    left, moved_m, moved_xyzw = np.empty((1, 4)), np.empty((1, 3)), np.empty((1, 4))
    quaternion(T, 0, left)
    x, y, z, w = left[0, 0], left[0, 1], left[0, 2], left[0, 3]
    n = 0
    for k in range(len(stamps_ns)):
        for r in range(3):
            moved_m[0, r] = T[r, 3]
            for c in range(3):
                moved_m[0, r] += T[r, c] * positions_m[k, c]
        a, b, c, d = quats_xyzw[k, 0], quats_xyzw[k, 1], quats_xyzw[k, 2], quats_xyzw[k, 3]
        moved_xyzw[0, 0] = w * a - z * b + y * c + x * d
        moved_xyzw[0, 1] = z * a + w * b - x * c + y * d
        moved_xyzw[0, 2] = -y * a + x * b + w * c + z * d
        moved_xyzw[0, 3] = -x * a - y * b - z * c + w * d
        n += tum_lines(stamps_ns[k : k + 1], moved_m, moved_xyzw, text[n:])
    return n
