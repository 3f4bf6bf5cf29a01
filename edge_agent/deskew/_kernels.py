"""Kernels of the `cpu` back end: paper, Algorithm 2, lines 8-10, with the matrices tabulated, in fixed point.

The programmable logic does the same (fpga_overlay/golden), to the bit.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam._motion_kernels import rotation_from_vector, vector_between

FASTMATH = {"contract", "nsz"}
BLOCK, AHEAD = 256, 64  # points
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
def deskew_points(points, t_offset_ns, shift, words, out):
    """out (N, 3) float32 = T_start_lidar(t) @ points (N, 3) float32, in steps of 2^-14 m.

    words (S, 28) int32: the table of fill_table. All values are whole numbers below 2^53, so that float64 is exact and
    the processor's wide registers can be used: x, y and z side by side, and many points of one segment at a time. In
    the order of a scan times rise, so its points come by segments; any other order only takes longer.
    """
    room = np.empty((3, BLOCK))
    segment = np.int64(0)
    for start in range(0, len(points), BLOCK):
        block, times_ns = points[start : start + BLOCK], t_offset_ns[start : start + BLOCK]
        x, y, z = room[0, : len(block)], room[1, : len(block)], room[2, : len(block)]
        for k in range(len(block)):
            x[k], y[k], z[k] = block[k, 0], block[k, 1], block[k, 2]
        to_steps(x)
        to_steps(y)
        to_steps(z)
        segment = move_block(x, y, z, times_ns, shift, words, segment)
        moved = out[start : start + BLOCK]
        for k in range(len(block)):
            moved[k, 0], moved[k, 1], moved[k, 2] = x[k], y[k], z[k]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def to_steps(values):
    """Coordinates (N,) in steps of 2^-14 m, halves rounded away from zero; within 24 bits. In place."""
    for k in range(len(values)):
        whole = min(np.floor(abs(values[k]) * 16384.0 + 0.5), 8388607.0)
        values[k] = whole if values[k] >= 0.0 else -whole


@njit(cache=True, nogil=True)
def span_of(words, segment, shift):
    """(first, end) ns whose nearest tick is in the segment: the first reaches back and the last ahead for ever."""
    half = (1 << shift) >> 1
    first = (np.int64(words[segment, 0]) << shift) - half if segment > 0 else np.int64(-1 << 40)
    end = (np.int64(words[segment + 1, 0]) << shift) - half if segment + 1 < len(words) else np.int64(1 << 40)
    return first, end


@njit(cache=True, nogil=True)
def together(times_ns, first_ns, end_ns):
    """How many times there are before the first one that is not in [first, end)."""
    out_at = np.int32(len(times_ns))
    for k in range(len(times_ns)):
        is_in = (first_ns <= times_ns[k]) & (times_ns[k] < end_ns)
        out_at = min(out_at, np.int32(len(times_ns)) if is_in else np.int32(k))
    return out_at


@njit(cache=True, nogil=True)
def move_block(x, y, z, times_ns, shift, words, segment):
    """x, y, z (N,) in steps of 2^-14 m become the moved points', m. Returns the last one's segment.

    segment: that of the points before; from there the next one is found by walking.
    """
    first_ns, end_ns = span_of(words, segment, shift)
    i = 0
    while i < len(times_ns):
        while times_ns[i] < first_ns or times_ns[i] >= end_ns:
            segment += -1 if times_ns[i] < first_ns else 1
            first_ns, end_ns = span_of(words, segment, shift)
        j = i + together(times_ns[i : i + AHEAD], first_ns, end_ns)
        move(x[i:j], y[i:j], z[i:j], times_ns[i:j], shift, words[segment])
        i = j
    return segment


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def move(x, y, z, times_ns, shift, word):
    """Points x, y, z (N,) of one segment, word (28,): from steps of 2^-14 m to m at the scan's reference time.

    Units: matrix 2^-25, 2^-18 m; times the point 2^-39 m.
    """
    half, begin = (1 << shift) >> 1, word[0]
    for k in range(len(times_ns)):
        tick = np.int32(min((max(np.int64(times_ns[k]), 0) + half) >> shift, 0xFFFFFF))
        dt = np.float64(min(max(np.int32(tick - begin), 0), 0x1FFFF)) * 2.0**-20
        a, b, c = at(word, 0, dt), at(word, 1, dt), at(word, 2, dt)
        moved_x = a * x[k] + b * y[k] + c * z[k] + at(word, 3, dt) * 2.0**21
        a, b, c = at(word, 4, dt), at(word, 5, dt), at(word, 6, dt)
        moved_y = a * x[k] + b * y[k] + c * z[k] + at(word, 7, dt) * 2.0**21
        a, b, c = at(word, 8, dt), at(word, 9, dt), at(word, 10, dt)
        moved_z = a * x[k] + b * y[k] + c * z[k] + at(word, 11, dt) * 2.0**21
        x[k], y[k], z[k] = in_metres(moved_x), in_metres(moved_y), in_metres(moved_z)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def at(word, e, dt):
    """Entry e of a segment's 3x4 matrix, dt slopes after its begin."""
    return word[4 + e] + np.floor(word[16 + e] * dt + 0.5)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def in_metres(moved):
    """From 2^-39 m to the nearest 2^-14 m. Beyond 512 m a coordinate saturates."""
    return min(max(np.floor(moved * 2.0**-25 + 0.5), -8388607.0), 8388607.0) * 2.0**-14
