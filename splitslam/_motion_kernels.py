"""Kernel behind motion_table: knots to short segments of affine motion."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

FASTMATH = {"contract", "nsz"}


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def rotation_from_vector(wx, wy, wz, R):
    """R (3, 3) = exp of the rotation vector, rad."""
    theta2 = wx * wx + wy * wy + wz * wz
    if theta2 < 1e-12:
        a, b = 1.0 - theta2 / 6.0, 0.5 - theta2 / 24.0
    else:
        theta = math.sqrt(theta2)
        a, b = math.sin(theta) / theta, (1.0 - math.cos(theta)) / theta2
    R[0, 0] = 1.0 - b * (wy * wy + wz * wz)
    R[0, 1] = b * wx * wy - a * wz
    R[0, 2] = b * wx * wz + a * wy
    R[1, 0] = b * wx * wy + a * wz
    R[1, 1] = 1.0 - b * (wx * wx + wz * wz)
    R[1, 2] = b * wy * wz - a * wx
    R[2, 0] = b * wx * wz - a * wy
    R[2, 1] = b * wy * wz + a * wx
    R[2, 2] = 1.0 - b * (wx * wx + wy * wy)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def vector_of(R, w):
    """w (3,) = log(R), rad, of R (3, 3) or (4, 4), at any angle: through its quaternion, by Shepperd's method."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    i = 0
    for k in range(1, 3):
        if R[k, k] > R[i, i]:
            i = k
    j, k = (i + 1) % 3, (i + 2) % 3
    if trace > R[i, i]:
        w[0], w[1], w[2], scalar = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 1.0 + trace
    else:
        w[i], w[j], w[k] = 1.0 + R[i, i] - R[j, j] - R[k, k], R[j, i] + R[i, j], R[k, i] + R[i, k]
        scalar = R[k, j] - R[j, k]
    sine = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    angle = 2.0 * math.atan2(sine, abs(scalar))
    scale = (angle / sine if sine > 0.0 else 0.0) * (-1.0 if scalar < 0.0 else 1.0)
    for e in range(3):
        w[e] *= scale


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def vector_between(A, B, w):
    """w (3,) = log(A^T B), rad. The rotation between two knots of one scan: below 90 degrees."""
    trace = 0.0
    for r in range(3):
        for c in range(3):
            trace += A[r, c] * B[r, c]
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        w[k] = 0.0
        for r in range(3):
            w[k] += 0.5 * (A[r, j] * B[r, i] - A[r, i] * B[r, j])
    sine = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    cosine = 0.5 * (trace - 1.0)
    scale = 1.0 if sine < 1e-9 else math.atan2(sine, cosine) / sine
    for k in range(3):
        w[k] *= scale


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def count_segments(offsets_ns, segment_ns, most, parts):
    """parts (K - 1,) int64: segments of at most segment_ns in each interval, longer ones if there are more than `most`.

    Returns how many there are.
    """
    last, count = len(parts), 0
    segment_ns = max(segment_ns, (offsets_ns[last] - offsets_ns[0]) // (most - last))
    for k in range(last):
        parts[k] = -(-(offsets_ns[k + 1] - offsets_ns[k]) // segment_ns)
        count += parts[k]
    return count


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def fill_segments(offsets_ns, rotation, translation_m, parts, breaks_ns, base, slope):
    """Cuts the interval between knots k and k + 1 into parts[k] equal segments.

    breaks_ns (S + 1,) int64; base (S, 12) float32 row-major 3x4 at each segment's start, slope (S, 12) float32 its
    change per nanosecond. Rotation by slerp, translation linear at the breaks.
    """
    A, B, D, R = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    w = np.empty(3)
    here, there = np.empty(12), np.empty(12)
    s = 0
    rotation_from_vector(rotation[0, 0], rotation[0, 1], rotation[0, 2], B)
    breaks_ns[0] = offsets_ns[0]
    for k in range(len(offsets_ns) - 1):
        A[:] = B
        rotation_from_vector(rotation[k + 1, 0], rotation[k + 1, 1], rotation[k + 1, 2], B)
        vector_between(A, B, w)
        span = offsets_ns[k + 1] - offsets_ns[k]
        for part in range(parts[k] + 1):
            f = part / parts[k]
            rotation_from_vector(f * w[0], f * w[1], f * w[2], D)
            for r in range(3):
                for c in range(3):
                    R[r, c] = A[r, 0] * D[0, c] + A[r, 1] * D[1, c] + A[r, 2] * D[2, c]
            for r in range(3):
                there[4 * r] = R[r, 0]
                there[4 * r + 1] = R[r, 1]
                there[4 * r + 2] = R[r, 2]
                there[4 * r + 3] = (1.0 - f) * translation_m[k, r] + f * translation_m[k + 1, r]
            if part > 0:
                breaks_ns[s + 1] = offsets_ns[k] + (span * part) // parts[k]
                inverse = 1.0 / (breaks_ns[s + 1] - breaks_ns[s])
                for e in range(12):
                    base[s, e] = here[e]
                    slope[s, e] = (there[e] - here[e]) * inverse
                s += 1
            here[:] = there


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def resample(offsets_ns, rotation, translation_m, times_ns, out_rotation, out_translation_m):
    """Knots at other times, sorted: rotation by slerp, translation linear, the end knots held."""
    A, B, D, R = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    w, identity = np.empty(3), np.eye(3)
    last = len(offsets_ns) - 2
    k = 0
    for i in range(len(times_ns)):
        t = min(max(times_ns[i], offsets_ns[0]), offsets_ns[last + 1])
        while k < last and t >= offsets_ns[k + 1]:
            k += 1
        f = (t - offsets_ns[k]) / (offsets_ns[k + 1] - offsets_ns[k])
        rotation_from_vector(rotation[k, 0], rotation[k, 1], rotation[k, 2], A)
        rotation_from_vector(rotation[k + 1, 0], rotation[k + 1, 1], rotation[k + 1, 2], B)
        vector_between(A, B, w)
        rotation_from_vector(f * w[0], f * w[1], f * w[2], D)
        for r in range(3):
            for c in range(3):
                R[r, c] = A[r, 0] * D[0, c] + A[r, 1] * D[1, c] + A[r, 2] * D[2, c]
            out_translation_m[i, r] = (1.0 - f) * translation_m[k, r] + f * translation_m[k + 1, r]
        vector_between(identity, R, out_rotation[i])
