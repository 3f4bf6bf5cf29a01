"""Kernels of the `cpu` back end: paper, Algorithm 2, lines 8-10, with the matrices tabulated, in fixed point.

The programmable logic does the same (fpga_overlay/golden), to the bit.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam._motion_kernels import rotation_from_vector, vector_between

FASTMATH = {"contract", "nsz"}
BLOCK = 256  # points
UNIFORM = 2.1  # knots that are even need no more than twice the even segment: whole parts of an interval


@njit(cache=True, nogil=True)
def parts_of(offsets_ns, last_ns, segment_ns):
    """How many segments of at most segment_ns all knot intervals between 0 and last_ns make."""
    total = 0
    for k in range(len(offsets_ns) - 1):
        span = min(offsets_ns[k + 1], last_ns) - max(offsets_ns[k], 0)
        if span > 0:
            total += (span + segment_ns - 1) // segment_ns
    return total


@njit(cache=True, nogil=True)
def lay_breaks(offsets_ns, last_ns, segment_ns, breaks_ns):
    """Cuts the time from the first knot (or 0) to last_ns; returns how many breaks, the end of the last one included.

    Every knot interval into equal parts of at most segment_ns; of a little more, if breaks_ns is too short for that;
    where that would make some far longer than others can be, all even, whatever the knots.
    """
    most = len(breaks_ns) - 1
    first_ns = max(offsets_ns[0], 0)
    even_ns = max((last_ns - first_ns + most - 1) // most, 1)
    if parts_of(offsets_ns, last_ns, segment_ns) > most:
        low, high = segment_ns, max(np.int64(UNIFORM * even_ns), segment_ns + 1)
        if parts_of(offsets_ns, last_ns, high) > most:
            for s in range(most + 1):
                breaks_ns[s] = first_ns + (last_ns - first_ns) * s // most
            return most + 1
        while high - low > 1000:
            middle = (low + high) // 2
            if parts_of(offsets_ns, last_ns, middle) > most:
                low = middle
            else:
                high = middle
        segment_ns = high
    count = 0
    breaks_ns[0] = first_ns
    for k in range(len(offsets_ns) - 1):
        start = max(offsets_ns[k], 0)
        span = min(offsets_ns[k + 1], last_ns) - start
        if span > 0:
            parts = (span + segment_ns - 1) // segment_ns
            for part in range(1, parts + 1):
                count += 1
                breaks_ns[count] = start + span * part // parts
    return count + 1


@njit(cache=True, nogil=True)
def longest(breaks_ns):
    """The longest time between breaks; 0 without any."""
    most = 0
    for s in range(len(breaks_ns) - 1):
        most = max(most, breaks_ns[s + 1] - breaks_ns[s])
    return most


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def bend(A, w, from_m, to_m, scale, bent):
    """What a knot interval's poses are sums of: bent (4, 12) = A | from, A [w] | 0, A [w]^2 | 0 and 0 | to - from.

    3x4, row-major, times scale (12,). A (3, 3): rotation at its start; w (3,): rotation vector over it.
    """
    bent[:] = 0.0
    for r in range(3):
        for c in range(3):
            i, j = (c + 1) % 3, (c + 2) % 3  # of column c of [w]: w_j in row i, -w_i in row j
            bent[0, 4 * r + c] = A[r, c] * scale[4 * r + c]
            bent[1, 4 * r + c] = (A[r, i] * w[j] - A[r, j] * w[i]) * scale[4 * r + c]
        bent[0, 4 * r + 3] = from_m[r] * scale[4 * r + 3]
        bent[3, 4 * r + 3] = (to_m[r] - from_m[r]) * scale[4 * r + 3]
        for c in range(3):
            i, j = (c + 1) % 3, (c + 2) % 3
            bent[2, 4 * r + c] = bent[1, 4 * r + i] * w[j] - bent[1, 4 * r + j] * w[i]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def fill_table(offsets_ns, rotation, translation_m, breaks_ns, shift, scale, table):
    """The words of the segments between breaks, each on its tick; the last one holds. False: motion out of range.

    table (S, 28) int32, breaks_ns (S,) int64, a tick is 2^shift ns. scale (12,) float64: units per entry of the 3x4
    base; a slope is 2^-20 of that, per tick. The pose at a break is slerp and linear between the knots around it.
    """
    A, B, w = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    bent = np.empty((4, 12))
    here, there = np.empty(12), np.empty(12)
    fits = True
    half = (1 << shift) >> 1
    knots = len(offsets_ns)
    k = -1
    angle = 0.0
    for s in range(len(breaks_ns)):
        tick = (breaks_ns[s] + half) >> shift
        t = min(max(tick << shift, offsets_ns[0]), offsets_ns[knots - 1])
        if k < 0 or (k < knots - 2 and t >= offsets_ns[k + 1]):
            k = max(k, 0)
            while k < knots - 2 and t >= offsets_ns[k + 1]:
                k += 1
            rotation_from_vector(rotation[k, 0], rotation[k, 1], rotation[k, 2], A)
            rotation_from_vector(rotation[k + 1, 0], rotation[k + 1, 1], rotation[k + 1, 2], B)
            vector_between(A, B, w)
            angle = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
            bend(A, w, translation_m[k], translation_m[k + 1], scale, bent)
        f = (t - offsets_ns[k]) / (offsets_ns[k + 1] - offsets_ns[k])
        first, second = f, 0.5 * f * f  # Rodrigues: A exp(f [w]) = A + first A [w] + second A [w]^2
        if angle > 1e-6:
            first, sine = math.sin(f * angle) / angle, math.sin(0.5 * f * angle) / angle
            second = 2.0 * sine * sine
        for r in range(3):
            for c in range(3):
                e = 4 * r + c
                there[e] = bent[0, e] + first * bent[1, e] + second * bent[2, e]
            there[4 * r + 3] = bent[0, 4 * r + 3] + f * bent[3, 4 * r + 3]
        if s > 0:
            ticks = tick - table[s - 1, 0]
            per_tick = 1048576.0 / ticks if ticks > 0 else 0.0
            for e in range(12):
                slope = math.floor((there[e] - here[e]) * per_tick + 0.5)
                fits = fits and abs(slope) < 2147483648.0
                table[s - 1, 16 + e] = np.int64(slope) if fits else 0
        table[s, 0], table[s, 1], table[s, 2], table[s, 3] = tick, 0, 0, 0
        for e in range(12):
            base = math.floor(there[e] + 0.5)
            fits = fits and abs(base) < 67108864.0
            table[s, 4 + e] = np.int64(base) if fits else 0
            table[s, 16 + e] = 0
            here[e] = there[e]
    return fits


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def lay_matrices(words, matrices):
    """matrices (S, 8, 4): base, then slope, of the table's words (S, 28); columns of their 3x4, each with a 0 below."""
    for s in range(len(words)):
        for c in range(4):
            matrices[s, c, 3] = matrices[s, 4 + c, 3] = 0.0
            for r in range(3):
                matrices[s, c, r], matrices[s, 4 + c, r] = words[s, 4 + 4 * r + c], words[s, 16 + 4 * r + c]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def deskew_points(points, t_offset_ns, shift, words, matrices, out):
    """out (N, 3) float32 = T_start_lidar(t) @ points (N, 3) float32, in steps of 2^-14 m.

    words (S, 28) int32: the table of fill_table; matrices (S, 8, 4) float64 scratch. All values are whole numbers below
    2^53, so that float64 is exact and the processor's wide registers can be used: for many points at a time where they
    are alike, else for the rows of a point. Beyond 512 m a coordinate saturates.
    """
    lay_matrices(words, matrices)
    steps, moved = np.empty((3, BLOCK)), np.empty((BLOCK, 4), np.float32)
    segment = 0
    for start in range(0, len(points), BLOCK):
        block, times_ns = points[start : start + BLOCK], t_offset_ns[start : start + BLOCK]
        for k in range(len(block)):
            steps[0, k], steps[1, k], steps[2, k] = to_steps(block[k, 0]), to_steps(block[k, 1]), to_steps(block[k, 2])
        segment = move_block(steps, times_ns, shift, words, matrices, segment, moved)
        goal = out[start : start + BLOCK]
        for k in range(len(goal)):
            goal[k, 0], goal[k, 1], goal[k, 2] = moved[k, 0], moved[k, 1], moved[k, 2]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def move_block(steps, t_offset_ns, shift, words, matrices, segment, moved):
    """moved (BLOCK, 4) float32: up to BLOCK points, steps (3, BLOCK) of 2^-14 m, deskewed, m. Returns the last segment.

    Times rise along a ring and along a scan, so the segment is found by walking from the last one.
    """
    half, last = (1 << shift) >> 1, len(words) - 1
    for k in range(len(t_offset_ns)):
        tick = min((max(np.int64(t_offset_ns[k]), 0) + half) >> shift, 0xFFFFFF)
        while segment > 0 and tick < words[segment, 0]:
            segment -= 1
        while segment < last and tick >= words[segment + 1, 0]:
            segment += 1
        dt = np.float64(min(max(tick - words[segment, 0], 0), 0x1FFFF)) * 2.0**-20
        x, y, z = steps[0, k], steps[1, k], steps[2, k]
        m = matrices[segment]
        for r in range(4):
            total = (m[0, r] + np.floor(m[4, r] * dt + 0.5)) * x
            total += (m[1, r] + np.floor(m[5, r] * dt + 0.5)) * y
            total += (m[2, r] + np.floor(m[6, r] * dt + 0.5)) * z
            total += (m[3, r] + np.floor(m[7, r] * dt + 0.5)) * 2.0**21  # 2^-18 m to 2^-39
            whole = np.floor(total * 2.0**-25 + 0.5)
            moved[k, r] = min(max(whole, -8388607.0), 8388607.0) * 2.0**-14
    return segment


@njit(cache=True, nogil=True)
def to_steps(v):
    """A coordinate in steps of 2^-14 m, halves rounded away from zero; within 24 bits."""
    whole = min(np.floor(abs(np.float64(v)) * 16384.0 + 0.5), 8388607.0)
    return whole if v >= 0.0 else -whole
