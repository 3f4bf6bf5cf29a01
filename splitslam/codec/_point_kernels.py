"""Kernel that models the points of a frame: what is expected of each from its ring, and from the ring below.

One pass codes, for every ring, how many points it has, and for every point its class, the columns since the last one,
the correction of its time, its three coordinates in steps and its intensity. Encoding and decoding run the same code
on the same integers. Expectations:

along (range): the last point, the straight continuation of the last two, and the ring below at this column times the
    ratio that held at the last point, weighted by how well each has done lately.
across (azimuth within the column): beams stand on a lattice, `drift` columns denser or wider than the image's columns;
    its phase is narrowed to what the coded points allow. Without a lattice the middle of the column.
up (elevation): a line in the range for each ring, which is what a beam that does not start in the origin looks like.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from splitslam.codec._coder_kernels import block, code_bit, code_number, level

FASTMATH = {"contract", "arcp", "nsz"}

TIME_UNIT_NS = 40_000
TURN = 1 << 20  # a column, in units of the lattice's phase
# points: rows of the array that is coded
CLASS, COLUMN, LATE, ALONG, ACROSS, UP, INTENSITY = range(7)
# scales: what all points of a frame share
RINGS, COLUMNS, RATE, LATTICE, DRIFT, WIDTH, WITH_INTENSITY = range(7)
LARGEST = 1 << 24  # steps a coordinate may have: 335 km at 2 cm
_LATEST = 1 << 17  # corrections of time: 5 s

# blocks of contexts and kinds of numbers; those before belong to what all points share
_COUNT, _BIT, _LATE, _GAP, _ALONG, _ACROSS, _UP, _SHADE, BLOCKS = 40, 44, 45, 50, 130, 330, 390, 430, 470
_K_COUNT, _K_BIT, _K_LATE, _K_GAP, _K_ALONG, _K_ACROSS, _K_UP, _K_SHADE, _K_LATER = range(4, 13)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def code_counts(state, data, model, counts):
    """counts (rings,) int64: points of each ring, as differences to the ring before."""
    before, change = 0, 0
    for r in range(len(counts)):
        beside = _COUNT + 1 + min(level(abs(change)) >> 2, 2)
        change = code_number(state, data, model, block(_COUNT, beside, beside, _K_COUNT), counts[r] - before, True)
        before += change
        counts[r] = before


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def code_points(state, data, model, counts, scales, lines, points):
    """points (7, N) int32, sorted by ring and column: coded, or filled while decoding. False: not a valid frame.

    counts (rings,): points of each ring, N in all. scales (7,) int64: see the names above; RATE in ns a column / 256,
    DRIFT in 2^-20 columns a column, WIDTH of a column in 2^-20 rad. lines (rings, 2) int64: offset (steps / 4) and
    slope (2^-14) of `up` against `along`.
    """
    lattice = np.zeros(3, np.int64)  # phase, its value and column at the start of a ring
    errors, usual = np.zeros(3, np.int64), np.full(3, 64, np.int64)
    below, below_end, i = 0, 0, 0
    late_at, late_before, up_size, across_size = -1, np.int64(0), np.int64(0), np.int64(0)
    for r in range(len(counts)):
        first = i
        errors[:] = usual
        under = below
        c, u, u_before, gap, size, shade, kind = 0, 0, 0, 0, 64, 8, 0
        ratio = 1 << 12
        for n in range(counts[r]):
            a, b, d, row = block(_BIT, _BIT, _BIT, _K_BIT)
            kind = code_bit(state, data, model, (a + kind, b + 2, d + 2, row), np.int64(points[CLASS, i]))
            points[CLASS, i] = kind

            # columns since the last point: near ones thin out to a fixed distance in metres
            spacing = points[COLUMN, under + 1] - points[COLUMN, under] if under + 1 < below_end else 0
            spread = level((u * scales[WIDTH]) >> 14) if u > 0 else 0
            a, b = _GAP + min(level(gap), 23), _GAP + 24 + min(spread, 29)
            d = _GAP + 54 + min(level(spacing), 23)
            last_gap = gap
            gap = code_number(state, data, model, block(a, b, d, _K_GAP), points[COLUMN, i] - c, False)
            seam = 1 if c <= late_at + 2 and c + gap >= late_at - 2 else 0
            c += gap
            if c >= scales[COLUMNS]:
                return False
            points[COLUMN, i] = c

            # time: where a scan begins and ends the same jump occurs in every ring
            a, b, d, row = block(_BIT, _BIT, _BIT, _K_LATE)
            a, b, d = a + 8 + seam, b + 10 + seam, d + 12 + seam
            late = np.int64(points[LATE, i])
            if code_bit(state, data, model, (a, b, d, row), 1 if late != 0 else 0):
                where = block(_LATE, _LATE + 1, _LATE + 2, _K_LATER)
                late = late_before + code_number(state, data, model, where, late - late_before, True)
                if abs(late) > _LATEST:
                    return False
                late_at, late_before = c, late
            else:
                late = np.int64(0)
            points[LATE, i] = late

            # range
            near, near_shade, has_below = u, 8, below_end > below
            if has_below:
                while under + 1 < below_end and points[COLUMN, under + 1] <= c:
                    under += 1
                near, near_shade = _ring_below(points, under, below_end, c)
            p0 = u if n > 0 else near
            p1 = p0
            if n >= 2 and last_gap > 0:
                p1 = u + min(max(((u - u_before) * gap) // last_gap, -(abs(u) >> 3)), abs(u) >> 3)
            p2 = (near * ratio) >> 12 if has_below else p0
            w0 = (1 << 30) // ((errors[0] + 8) * (errors[0] + 8))
            w1 = (1 << 30) // ((errors[1] + 8) * (errors[1] + 8))
            w2 = (1 << 30) // ((errors[2] + 8) * (errors[2] + 8)) if has_below else 0
            expected = (p0 * w0 + p1 * w1 + p2 * w2) // (w0 + w1 + w2)
            least = min(errors[0], min(errors[1], errors[2]))
            apart = min(level(abs(p2 - expected)), 19)
            a = _ALONG + min(level(least >> 3), 19) * 6 + min(level(gap) >> 1, 5)
            b = _ALONG + 120 + (20 + apart if p2 > expected else 20 - apart)
            d = _ALONG + 160 + min(level(size), 30)
            rest = code_number(state, data, model, block(a, b, d, _K_ALONG), points[ALONG, i] - expected, True)
            u_before, u = u, expected + rest
            if abs(u) > LARGEST:
                return False
            points[ALONG, i] = u
            size = abs(rest)
            if n > 0 or has_below:
                errors[0] = min(errors[0] + (((abs(u - p0) << 4) - errors[0]) >> 2), 1 << 12)
                errors[1] = min(errors[1] + (((abs(u - p1) << 4) - errors[1]) >> 2), 1 << 12)
                errors[2] = min(errors[2] + (((abs(u - p2) << 4) - errors[2]) >> 2), 1 << 12)
            if has_below and near > 0:
                seen = min(max((u << 12) // near, 1 << 10), 1 << 14)
                ratio += (seen - ratio) >> (1 if abs(seen - ratio) < 600 else 2)

            # azimuth within the column
            width = u * scales[WIDTH]
            expected = 0
            if scales[LATTICE]:
                turned = gap
                if late != 0 and scales[RATE] != 0:
                    turned += (late * (TIME_UNIT_NS * 256)) // scales[RATE]
                _advance(lattice, c, turned, scales[DRIFT], n == 0)
                expected = ((lattice[0] >> 4) * width + (1 << 35)) >> 36
            a = _ACROSS + min(level(max(width, 0) >> 18), 29)
            b = _ACROSS + 30 + min(level(across_size), 19)
            rest = code_number(state, data, model, block(a, b, _ACROSS + 50, _K_ACROSS), points[ACROSS, i] - expected, True)
            v = expected + rest
            if abs(v) > LARGEST:
                return False
            points[ACROSS, i] = v
            across_size = (across_size + 2 * abs(rest) + 1) >> 1
            if scales[LATTICE]:
                if rest != 0 and width > 0:  # as far as the coded point allows, and no further
                    edge = min(max(2 * v - (1 if rest > 0 else -1), -(1 << 22)), 1 << 22)
                    lattice[0] = min(max((edge << 39) // width, -(TURN >> 1)), TURN >> 1)
                if n == 0:
                    lattice[1], lattice[2] = lattice[0], c

            # elevation
            expected = ((lines[r, 0] << 12) + lines[r, 1] * u + (1 << 13)) >> 14
            a, b = _UP + min(level(up_size), 14), _UP + 15 + min(level(abs(u)) >> 1, 19)
            rest = code_number(state, data, model, block(a, b, _UP + 35, _K_UP), points[UP, i] - expected, True)
            up_size = (up_size + 2 * abs(rest) + 1) >> 1
            if abs(expected + rest) > LARGEST:
                return False
            points[UP, i] = expected + rest

            if scales[WITH_INTENSITY]:
                differs = min(abs(near_shade - shade), 7) + (8 if near_shade < shade else 0)
                a, b, d = _SHADE + shade, _SHADE + 16 + differs, _SHADE + 32
                rest = code_number(state, data, model, block(a, b, d, _K_SHADE), points[INTENSITY, i] - shade, True)
                shade += rest
                if shade < 0 or shade > 15:
                    return False
                points[INTENSITY, i] = shade
            i += 1
        if counts[r] > 0:
            usual[:] = errors
            below, below_end = first, i
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _ring_below(points, under, end, c):
    """(range, intensity) of the ring below at column c, which lies between its points `under` and the next."""
    u, shade = np.int64(points[ALONG, under]), np.int64(points[INTENSITY, under])
    left = c - points[COLUMN, under]
    if left > 0 and under + 1 < end:
        right = points[COLUMN, under + 1] - c
        next_u = np.int64(points[ALONG, under + 1])
        if right < left:
            shade = np.int64(points[INTENSITY, under + 1])
        if abs(next_u - u) < (u >> 3):
            u = (u * right + next_u * left) // (left + right)
        elif right < left:
            u = next_u
    return u, shade


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _advance(lattice, c, turned, drift, starts):
    """The lattice's phase `turned` columns on, or at the start of a ring, from where the ring before started."""
    phase = lattice[1] + drift * (c - lattice[2]) if starts else lattice[0] + drift * turned
    lattice[0] = ((phase + (TURN >> 1)) & (TURN - 1)) - (TURN >> 1)
