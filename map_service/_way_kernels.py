"""Kernels of stored ways: poses as small numbers against a prediction, and which of them the others follow from.

Ways are poses (n, 4, 4) T_map_lidar at times (n,), s. Between two kept poses the robot moves with a constant twist, on
a straight line or an arc: T(s) = T_a exp(s log(T_a^-1 T_b)).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam._motion_kernels import rotation_from_vector, vector_of
from splitslam._se3_kernels import exp, inverse, log, multiply

FASTMATH = {"contract", "arcp", "nsz"}
_LONGEST_S = 10.0  # so far ahead a motion is believed
_SHORTEST_S = 1e-3


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _ahead(T, twist, dt_s, xi, step, out):
    """out = where a robot at T with a twist (6,), rad/s and m/s, is dt_s later. xi (6,), step (4, 4): scratch."""
    for k in range(6):
        xi[k] = twist[k] * min(dt_s, _LONGEST_S)
    exp(xi, step)
    multiply(T, step, out)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _moved(T, r, share, turn, out):
    """out = T, moved by `share` of r (6,): rotation vector and shift, both in T's own axes. turn (3, 3): scratch."""
    rotation_from_vector(share * r[0], share * r[1], share * r[2], turn)
    for i in range(3):
        out[i, 3] = T[i, 3]
        for j in range(3):
            out[i, 3] += T[i, j] * share * r[3 + j]
            out[i, j] = T[i, 0] * turn[0, j] + T[i, 1] * turn[1, j] + T[i, 2] * turn[2, j]
    out[3, 0], out[3, 1], out[3, 2], out[3, 3] = 0.0, 0.0, 0.0, 1.0


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _apart(T_a, T_b, turn, r):
    """r (6,) with T_b = T_a moved by r. turn (3, 3): scratch."""
    for i in range(3):
        r[3 + i] = 0.0
        for j in range(3):
            turn[i, j] = T_a[0, i] * T_b[0, j] + T_a[1, i] * T_b[1, j] + T_a[2, i] * T_b[2, j]
            r[3 + i] += T_a[j, i] * (T_b[j, 3] - T_a[j, 3])
    vector_of(turn, r)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def code_way(poses, times_s, steps, gains, numbers, coded):
    """Poses as numbers (n, 6) int64 of steps (2,), rad and m, from where an alpha-beta filter expects each.

    gains (2,): the filter's, of pose and twist (Kalata, "The Tracking Index", IEEE TAES 20(2), 1984). The first pose is
    told from the identity. coded (n, 4, 4): what `decode_way` will make of it. Returns roughly how many bits they take.
    """
    T, expected, step, turn = np.eye(4), np.empty((4, 4)), np.empty((4, 4)), np.empty((3, 3))
    twist, xi, r = np.zeros(6), np.empty(6), np.empty(6)
    bits = 0.0
    for i in range(len(poses)):
        dt_s = max(times_s[i] - times_s[i - 1], _SHORTEST_S) if i else 0.0
        _ahead(T, twist, dt_s, xi, step, expected)
        _apart(expected, poses[i], turn, r)
        for k in range(6):
            numbers[i, k] = round(r[k] / steps[k // 3])
            r[k] = numbers[i, k] * steps[k // 3]
            bits += math.log2(1.0 + 2.0 * abs(numbers[i, k]))
        _moved(expected, r, 1.0, turn, coded[i])
        _follow(expected, r, dt_s, gains, turn, twist, T)
    return bits


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _follow(expected, r, dt_s, gains, turn, twist, T):
    """The filter takes what it did not expect. dt_s 0: the first pose, at which it begins."""
    _moved(expected, r, gains[0] if dt_s > 0.0 else 1.0, turn, T)
    if dt_s > 0.0:
        for k in range(6):
            twist[k] += gains[1] * r[k] / min(dt_s, _LONGEST_S)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def decode_way(numbers, times_s, steps, gains, poses):
    """The reverse of `code_way`: poses (n, 4, 4)."""
    T, expected, step, turn = np.eye(4), np.empty((4, 4)), np.empty((4, 4)), np.empty((3, 3))
    twist, xi, r = np.zeros(6), np.empty(6), np.empty(6)
    for i in range(len(poses)):
        dt_s = max(times_s[i] - times_s[i - 1], _SHORTEST_S) if i else 0.0
        _ahead(T, twist, dt_s, xi, step, expected)
        for k in range(6):
            r[k] = numbers[i, k] * steps[k // 3]
        _moved(expected, r, 1.0, turn, poses[i])
        _follow(expected, r, dt_s, gains, turn, twist, T)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def fill_way(poses, times_s, kept):
    """Poses (n, 4, 4) that are not `kept` (n,), from those that are; the first and the last one are."""
    back, between, step = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    xi, part = np.empty(6), np.empty(6)
    a = 0
    for b in range(1, len(poses)):
        if not kept[b]:
            continue
        if b > a + 1:
            inverse(poses[a], back)
            multiply(back, poses[b], between)
            log(between, xi)
        for i in range(a + 1, b):
            share = (times_s[i] - times_s[a]) / (times_s[b] - times_s[a])
            for k in range(6):
                part[k] = share * xi[k]
            exp(part, step)
            multiply(poses[a], step, poses[i])
        a = b


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _follows(poses, times_s, numbers, limits, a, b):
    """Do those between a and b follow from them within limits (3,): rad, m, and s from where their number would be?"""
    back, between, step = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    xi, part = np.empty(6), np.empty(6)
    inverse(poses[a], back)
    multiply(back, poses[b], between)
    log(between, xi)
    chord = 8.0 * math.sin(0.5 * limits[0]) ** 2  # |R - R'|_F^2 = 8 sin^2(angle / 2)
    span_s, count = times_s[b] - times_s[a], numbers[b] - numbers[a]
    for i in range(a + 1, b):
        share = (times_s[i] - times_s[a]) / span_s
        if abs(share - (numbers[i] - numbers[a]) / count) * span_s > limits[2]:
            return False
        for k in range(6):
            part[k] = share * xi[k]
        exp(part, step)
        multiply(poses[a], step, between)
        turned = moved = 0.0
        for r in range(3):
            moved += (between[r, 3] - poses[i, r, 3]) ** 2
            for c in range(3):
                turned += (between[r, c] - poses[i, r, c]) ** 2
        if turned > chord or moved > limits[1] ** 2:
            return False
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def thin_way(poses, times_s, numbers, limits, kept):
    """Which poses to keep (n,) bool so that the others follow from them within limits (3,), as `_follows` has it.

    numbers (n,): of the scans; times between kept ones go by them. Each time the furthest that a doubling reach and
    then halving finds.
    """
    n = len(poses)
    kept[:] = False
    kept[0] = kept[n - 1] = True
    a = 0
    while a < n - 1:
        good, reach = a + 1, 2
        bad = n
        while good < n - 1:
            b = min(a + reach, n - 1)
            if not _follows(poses, times_s, numbers, limits, a, b):
                bad = b
                break
            good, reach = b, 2 * reach
        while bad - good > 1 and bad < n:
            b = (good + bad) // 2
            if _follows(poses, times_s, numbers, limits, a, b):
                good = b
            else:
                bad = b
        kept[good] = True
        a = good


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def hold(values, bounds, steps, changed, numbers):
    """Rows of values (n, c) as numbers (n, c) int64 of steps (c,), held until one is off by more than its bound (c,).

    changed (n,) bool: rows that are new; the first one is.
    """
    n, width = values.shape
    for i in range(n):
        changed[i] = i == 0
        if i:
            for k in range(width):
                if abs(values[i, k] - numbers[i - 1, k] * steps[k]) > bounds[k]:
                    changed[i] = True
        for k in range(width):
            numbers[i, k] = round(values[i, k] / steps[k]) if changed[i] else numbers[i - 1, k]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def apart(A, B, out):
    """out (n, 6) with B = A moved by it: rotation vector and shift, both in A's own axes. A, B: (n, 4, 4)."""
    turn = np.empty((3, 3))
    for i in range(len(A)):
        _apart(A[i], B[i], turn, out[i])


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def moved(A, r, out):
    """out (n, 4, 4) = A (n, 4, 4), each moved by r (n, 6)."""
    turn = np.empty((3, 3))
    for i in range(len(A)):
        _moved(A[i], r[i], 1.0, turn, out[i])
