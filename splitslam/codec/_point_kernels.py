"""Kernels that model the points of a frame: what is expected of each from its ring, and from the ring below.

For every ring pass how many points it has, then for every point the columns since the last one, the correction of its
time, its range, its class, the two other coordinates in steps and its intensity. Encoding and decoding run the same
code on the same integers.
"""

from __future__ import annotations

import numpy as np

from splitslam.codec._coder_kernels import bits_of, block, code_flag, code_number, level
from splitslam.codec._jit import borrowing, inlined

TIME_UNIT_NS = 40_000
TURN = 1 << 20  # a column, in units of the lattice's phase
LARGEST = 1 << 24  # steps a coordinate may have: 335 km at 2 cm
_LATEST = 1 << 17  # corrections of time: 5 s
_SEAM_LEAST = 16  # smaller ones are jitter

# rows of `points`
CLASS, COLUMN, LATE, ALONG, ACROSS, UP, INTENSITY = range(7)
# `scales`, what all points of a frame share: columns; ns a column / 256; whether there is a lattice, its drift in 2^-20
# columns a column; width of a column, 2^-20 rad; whether intensity is coded
COLUMNS, RATE, LATTICE, DRIFT, WIDTH, SHADES = range(6)
# `now`, what is known while the points pass
_N, _GAP, _GAP_BEFORE, _GAP_BITS, _LATE, _LATE_BEFORE, _LATE_AT, _U, _U_BEFORE, _REST, _RATIO = range(11)
_ERROR, _USUAL, _BELOW, _BELOW_END, _UNDER, _NEAR, _NEAR_CLASS, _NEAR_SHADE = 11, 14, 17, 18, 19, 20, 21, 22
_PHASE, _PHASE_START, _COLUMN_START, _ACROSS_SIZE, _UP_SIZE, _BEFORE = range(23, 29)
NOW = 29

# first blocks of contexts of each kind of number: one for all of the kind, then those of its three contexts; those
# before belong to what all points share
_COUNT, _SEAM, _LATE_BY, _GAPS, _RANGE, _CORNER, _AZIMUTH, _ELEVATION, _SHADE, BLOCKS = (
    50,
    54,
    63,
    67,
    170,
    393,
    458,
    521,
    559,
    608,
)
_WEIGHT = (65536 * 1024 // (4 * np.arange(1024, dtype=np.int64) + 10) ** 2).astype(np.int32)


@borrowing
def code_counts(state, data, model, counts):
    """counts (rings,) int64: points of each ring, as differences to the ring before.

    Returns their sum, or -1 when one is below 0.
    """
    before, change, total = np.int64(0), np.int64(0), np.int64(0)
    for r in range(len(counts)):
        beside = _COUNT + 1 + min(level(abs(change)) >> 2, 2)
        where = block(beside, beside, beside, _COUNT)
        change = code_number(state, data, model, where, counts[r] - before, True, bits_of(abs(change)), 2)
        before += change
        if before < 0:
            return -1
        counts[r] = before
        total += before
    return total


@borrowing
def code_lines(state, data, model, offsets, slopes, lines):
    """lines (rings, 2) int64: as differences to the ring before. offsets, slopes: where their contexts begin."""
    for part in range(2):
        before, change = np.int64(0), np.int64(0)
        for r in range(len(lines)):
            first = offsets if part == 0 else slopes
            beside = first + 1 + min(level(abs(change)), 8)
            where = block(first, beside, beside, first)
            change = code_number(state, data, model, where, lines[r, part] - before, True, 1, 2)
            before = min(max(before + change, -(1 << 24)), 1 << 24)
            lines[r, part] = before


@borrowing
def code_points(state, data, model, counts, scales, lines, points, now):
    """points (7, N) int32, sorted by ring and column: coded, or filled while decoding. False: not a valid frame.

    counts (rings,): points of each ring, N in all. scales (6,) int64. lines (rings, 2) int64: offset (steps / 4) and
    slope (2^-14) of UP against ALONG. now (NOW,) int64: scratch.
    """
    now[:] = 0
    now[_LATE_AT], now[_GAP_BITS] = -(1 << 20), 32
    now[_USUAL : _USUAL + 3] = 64
    i = 0
    for r in range(len(counts)):
        _enter_ring(now)
        first, column = i, np.int64(0)
        for n in range(counts[r]):
            now[_N] = n
            now[_BEFORE] = np.int64(points[CLASS, i - 1]) if n > 0 else 0
            column = _code_column(state, data, model, scales, points, i, now)
            if column >= scales[COLUMNS] or not _code_late(state, data, model, points, i, now):
                return False
            _look_below(points, column, now)
            _code_along(state, data, model, points, i, now)
            _code_class(state, data, model, points, i, now)
            _code_across(state, data, model, scales, points, i, now)
            _code_up(state, data, model, lines[r], points, i, now)
            if max(abs(points[ALONG, i]), max(abs(points[ACROSS, i]), abs(points[UP, i]))) > LARGEST:
                return False
            if scales[SHADES] and not _code_shade(state, data, model, points, i, now):
                return False
            i += 1
        if counts[r] > 0:
            for k in range(3):
                now[_USUAL + k] = now[_ERROR + k]
            now[_BELOW], now[_BELOW_END] = first, i
    return True


@inlined
def _enter_ring(now):
    for k in range(3):
        now[_ERROR + k] = now[_USUAL + k]
    now[_UNDER] = now[_BELOW]
    now[_GAP], now[_U], now[_U_BEFORE], now[_REST], now[_RATIO] = 0, 0, 0, 64, 1 << 12


@inlined
def _code_column(state, data, model, scales, points, i, now):
    """As columns since the last point: thinning leaves a certain distance in metres, so the range says how many."""
    n, under = now[_N], now[_UNDER]
    before = np.int64(points[COLUMN, i - 1]) if n > 0 else np.int64(0)
    spacing = points[COLUMN, under + 1] - points[COLUMN, under] if under + 1 < now[_BELOW_END] else 0
    a = _GAPS + 1 + 24 * now[_BEFORE] + min(level(now[_GAP]), 23)
    b = _GAPS + 49 + min(level((now[_U] * scales[WIDTH]) >> 14), 29)
    c = _GAPS + 79 + min(level(spacing), 23)
    guess = min(max((now[_GAP_BITS] + 8) >> 4, 1), 12)
    where, gap = block(a, b, c, _GAPS), points[COLUMN, i] - before
    gap = code_number(state, data, model, where, gap, False, guess, 2)
    if n > 0:
        now[_GAP_BITS] += ((bits_of(gap) << 4) - now[_GAP_BITS]) >> 2
    now[_GAP_BEFORE], now[_GAP] = now[_GAP], gap
    column = before + gap
    points[COLUMN, i] = min(column, 65535)
    return column


@inlined
def _code_late(state, data, model, points, i, now):
    """The correction of the time: jitter, and where a scan begins and ends the same jump in every ring."""
    column = points[COLUMN, i]
    seam = 1 if column - now[_GAP] <= now[_LATE_AT] + 2 and column >= now[_LATE_AT] - 2 else 0
    late, goes_on = np.int64(points[LATE, i]), 1 if now[_LATE] != 0 else 0
    where = block(_SEAM + 1 + seam, _SEAM + 3 + seam + 2 * goes_on, _SEAM + 7 + goes_on, _SEAM)
    if code_flag(state, data, model, where, 1 if late != 0 else 0):
        where, expected = block(_LATE_BY + 1, _LATE_BY + 1, _LATE_BY + 2 + seam, _LATE_BY), now[_LATE_BEFORE] * seam
        late = expected + code_number(state, data, model, where, late - expected, True, 1, 2)
        if abs(late) > _SEAM_LEAST:
            now[_LATE_AT], now[_LATE_BEFORE] = column, late
    else:
        late = np.int64(0)
    points[LATE, i] = now[_LATE] = late
    return abs(late) <= _LATEST


@inlined
def _look_below(points, column, now):
    """Range, class and intensity of the ring below at a column: of the nearest point, or between two on one surface."""
    end, under = now[_BELOW_END], now[_UNDER]
    if end == now[_BELOW]:
        now[_NEAR], now[_NEAR_CLASS], now[_NEAR_SHADE] = now[_U], 0, 8
        return
    while under + 1 < end and points[COLUMN, under + 1] <= column:
        under += 1
    now[_UNDER] = under
    u, nearest = np.int64(points[ALONG, under]), under
    left = column - points[COLUMN, under]
    if left > 0 and under + 1 < end:
        right = points[COLUMN, under + 1] - column
        next_u = np.int64(points[ALONG, under + 1])
        if right < left:
            nearest = under + 1
        if abs(next_u - u) < (u >> 3):
            u = (u * right + next_u * left) // (left + right)
        elif right < left:
            u = next_u
    now[_NEAR], now[_NEAR_CLASS], now[_NEAR_SHADE] = u, points[CLASS, nearest], points[INTENSITY, nearest]


@inlined
def _code_along(state, data, model, points, i, now):
    """The range. Three guesses, weighted by how well each has done lately: the last point; the straight continuation
    of the last two; the ring below here, times the ratio that held at the last point."""
    n, u, near, gap = now[_N], now[_U], now[_NEAR], now[_GAP]
    has_below = now[_BELOW_END] > now[_BELOW]
    p0 = u if n > 0 else near
    p1 = p0
    if n >= 2 and now[_GAP_BEFORE] > 0:
        p1 = u + min(max(((u - now[_U_BEFORE]) * gap) // now[_GAP_BEFORE], -(abs(u) >> 3)), abs(u) >> 3)
    p2 = (near * now[_RATIO]) >> 12 if has_below else p0
    w0, w1 = _weight(now[_ERROR]), _weight(now[_ERROR + 1])
    w2 = _weight(now[_ERROR + 2]) if has_below else 0
    expected = (p0 * w0 + p1 * w1 + p2 * w2) // (w0 + w1 + w2)

    least = min(now[_ERROR], min(now[_ERROR + 1], now[_ERROR + 2]))
    apart = min(level(abs(p2 - expected)), 19)
    a = _RANGE + 1 + min(level(least >> 3), 19) * 6 + min(level(gap) >> 1, 5)
    b = _RANGE + 121 + (20 + apart if p2 > expected else 20 - apart)
    c = _RANGE + 161 + 31 * now[_BEFORE] + min(level(now[_REST]), 30)
    where, rest = block(a, b, c, _RANGE), points[ALONG, i] - expected
    rest = code_number(state, data, model, where, rest, True, bits_of(least >> 4), 0)
    now[_U_BEFORE], now[_U], now[_REST] = u, expected + rest, abs(rest)
    u = now[_U]
    points[ALONG, i] = min(max(u, -LARGEST - 1), LARGEST + 1)
    if n > 0 or has_below:
        _judge(now, 0, u - p0)
        _judge(now, 1, u - p1)
        _judge(now, 2, u - p2)
    if has_below and near > 0:
        change = min(max((u << 12) // near, 1 << 10), 1 << 14) - now[_RATIO]
        now[_RATIO] += change >> (1 if abs(change) < 600 else 2)


@inlined
def _weight(error):
    return np.int64(_WEIGHT[(error >> 2) & 1023])


@inlined
def _judge(now, guess, error):
    """The running error of a guess, in sixteenths of a step."""
    e = now[_ERROR + guess]
    now[_ERROR + guess] = min(e + (((abs(error) << 4) - e) >> 2), 4095)


@inlined
def _code_class(state, data, model, points, i, now):
    """1 for a corner. Its range is not what was expected, and below it is another."""
    n, before = now[_N], now[_BEFORE]
    twice = before + 2 * np.int64(points[CLASS, i - 2]) if n > 1 else before
    a = _CORNER + 1 + twice
    b = _CORNER + 5 + min(level(now[_REST]), 19) + 20 * now[_NEAR_CLASS]
    c = _CORNER + 45 + min(level(now[_GAP]), 19)
    points[CLASS, i] = code_flag(state, data, model, block(a, b, c, _CORNER), np.int64(points[CLASS, i]))


@inlined
def _code_across(state, data, model, scales, points, i, now):
    """The azimuth within the column. Beams stand on a lattice that drifts through the columns; its phase is narrowed
    to what the coded points allow. Without a lattice the middle of the column is expected."""
    width, expected = now[_U] * scales[WIDTH], np.int64(0)
    if scales[LATTICE]:
        _advance(points[COLUMN, i], scales, now)
        expected = ((now[_PHASE] >> 4) * width + (1 << 35)) >> 36
    a = _AZIMUTH + 1 + min(level(width >> 18), 29)
    b = _AZIMUTH + 31 + min(level(now[_ACROSS_SIZE]), 19)
    c = _AZIMUTH + 51 + min(level(now[_GAP]) >> 1, 11)
    where, rest = block(a, b, c, _AZIMUTH), points[ACROSS, i] - expected
    rest = code_number(state, data, model, where, rest, True, bits_of(now[_ACROSS_SIZE] >> 1), 2)
    v = expected + rest
    points[ACROSS, i] = min(max(v, -LARGEST - 1), LARGEST + 1)
    now[_ACROSS_SIZE] = (now[_ACROSS_SIZE] + 2 * abs(rest) + 1) >> 1
    if rest != 0 and width > 0:
        edge = min(max(2 * v - (1 if rest > 0 else -1), -(1 << 22)), 1 << 22)
        now[_PHASE] = min(max((edge << 39) // width, -(TURN >> 1)), TURN >> 1)
    if now[_N] == 0:
        now[_PHASE_START], now[_COLUMN_START] = now[_PHASE], points[COLUMN, i]


@inlined
def _advance(column, scales, now):
    """The phase since the last point; at the start of a ring, since the start of the ring before."""
    if now[_N] == 0:
        phase = now[_PHASE_START] + scales[DRIFT] * (column - now[_COLUMN_START])
    else:
        turned = now[_GAP]
        if now[_LATE] != 0 and scales[RATE] != 0:
            turned += (now[_LATE] * (TIME_UNIT_NS * 256)) // scales[RATE]
        phase = now[_PHASE] + scales[DRIFT] * turned
    now[_PHASE] = ((phase + (TURN >> 1)) & (TURN - 1)) - (TURN >> 1)


@inlined
def _code_up(state, data, model, line, points, i, now):
    """The elevation: a line in the range, which is what a beam that does not start in the origin looks like."""
    u = now[_U]
    expected = ((line[0] << 12) + line[1] * u + (1 << 13)) >> 14
    a = _ELEVATION + 1 + min(level(now[_UP_SIZE]), 14)
    b = _ELEVATION + 16 + min(level(abs(u)) >> 1, 19)
    c = _ELEVATION + 36 + np.int64(points[CLASS, i])
    where, rest = block(a, b, c, _ELEVATION), points[UP, i] - expected
    rest = code_number(state, data, model, where, rest, True, bits_of(now[_UP_SIZE] >> 1), 2)
    now[_UP_SIZE] = (now[_UP_SIZE] + 2 * abs(rest) + 1) >> 1
    points[UP, i] = min(max(expected + rest, -LARGEST - 1), LARGEST + 1)


@inlined
def _code_shade(state, data, model, points, i, now):
    """The intensity, 0 to 15; False when it is not."""
    shade, near = np.int64(points[INTENSITY, i - 1]) if now[_N] > 0 else np.int64(8), now[_NEAR_SHADE]
    a = _SHADE + 1 + shade
    b = _SHADE + 17 + min(abs(near - shade), 7) + (8 if near < shade else 0)
    c = _SHADE + 33 + min(level(now[_REST]) >> 1, 7) + 8 * np.int64(points[CLASS, i])
    where, change = block(a, b, c, _SHADE), points[INTENSITY, i] - shade
    shade += code_number(state, data, model, where, change, True, 1, 2)
    points[INTENSITY, i] = min(max(shade, 0), 15)
    return 0 <= shade <= 15
