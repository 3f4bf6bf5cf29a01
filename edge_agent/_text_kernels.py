"""Poses as lines of text: an IMU's rate makes of a few microseconds a line a good part of a core."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

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
