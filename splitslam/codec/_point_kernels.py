"""Kernels that model the points of a frame: what is expected of each from its ring, and from the ring below.

For every ring pass how many points it has, then for every point its class, the columns since the last one, the
correction of its time, its three coordinates in steps and its intensity. Encoding and decoding run the same code on
the same integers.
"""

from __future__ import annotations

import numpy as np

from splitslam.codec._coder_kernels import block, code_bit, code_number, level
from splitslam.codec._jit import borrowing

TIME_UNIT_NS = 40_000
TURN = 1 << 20  # a column, in units of the lattice's phase
LARGEST = 1 << 24  # steps a coordinate may have: 335 km at 2 cm
_LATEST = 1 << 17  # corrections of time: 5 s

# rows of `points`
CLASS, COLUMN, LATE, ALONG, ACROSS, UP, INTENSITY = range(7)
# `scales`, what all points of a frame share: columns; ns a column / 256; whether there is a lattice, its drift in 2^-20
# columns a column; width of a column, 2^-20 rad; whether intensity is coded
COLUMNS, RATE, LATTICE, DRIFT, WIDTH, SHADES = range(6)
# `now`, what is known while the points pass
_N, _GAP, _GAP_BEFORE, _LATE, _LATE_BEFORE, _LATE_AT, _U, _U_BEFORE, _REST, _RATIO = range(10)
_ERROR, _USUAL, _BELOW, _BELOW_END, _UNDER, _NEAR, _NEAR_SHADE = 10, 13, 16, 17, 18, 19, 20
_PHASE, _PHASE_START, _COLUMN_START, _ACROSS_SIZE, _UP_SIZE = range(21, 26)
NOW = 26

# blocks of contexts and kinds of numbers; those before belong to what all points share
_B_COUNT, _B_BIT, _B_LATE, _B_GAP, _B_ALONG, _B_ACROSS, _B_UP, _B_SHADE, BLOCKS = (
    40,
    44,
    45,
    50,
    130,
    330,
    390,
    430,
    470,
)
_K_COUNT, _K_BIT, _K_SEAM, _K_LATE, _K_GAP, _K_ALONG, _K_ACROSS, _K_UP, _K_SHADE = range(4, 13)


@borrowing
def code_counts(state, data, model, counts):
    """counts (rings,) int64: points of each ring, as differences to the ring before."""
    before, change = 0, 0
    for r in range(len(counts)):
        beside = _B_COUNT + 1 + min(level(abs(change)) >> 2, 2)
        change = code_number(state, data, model, block(_B_COUNT, beside, beside, _K_COUNT), counts[r] - before, True)
        before += change
        counts[r] = before


@borrowing
def code_points(state, data, model, counts, scales, lines, points, now):
    """points (7, N) int32, sorted by ring and column: coded, or filled while decoding. False: not a valid frame.

    counts (rings,): points of each ring, N in all. scales (6,) int64. lines (rings, 2) int64: offset (steps / 4) and
    slope (2^-14) of UP against ALONG. now (NOW,) int64: scratch.
    """
    now[:] = 0
    now[_LATE_AT] = -(1 << 20)
    now[_USUAL : _USUAL + 3] = 64
    i = 0
    for r in range(len(counts)):
        _enter_ring(now)
        first, column = i, np.int64(0)
        for n in range(counts[r]):
            now[_N] = n
            _code_class(state, data, model, points, i, now)
            column = _code_column(state, data, model, scales, points, i, now)
            if column >= scales[COLUMNS] or not _code_late(state, data, model, points, i, now):
                return False
            _look_below(points, column, now)
            _code_along(state, data, model, points, i, now)
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


@borrowing
def _enter_ring(now):
    for k in range(3):
        now[_ERROR + k] = now[_USUAL + k]
    now[_UNDER] = now[_BELOW]
    now[_GAP], now[_U], now[_U_BEFORE], now[_REST], now[_RATIO] = 0, 0, 0, 64, 1 << 12


@borrowing
def _code_class(state, data, model, points, i, now):
    before = np.int64(points[CLASS, i - 1]) if now[_N] > 0 else 0
    twice = before + 2 * np.int64(points[CLASS, i - 2]) if now[_N] > 1 else before
    a, b, c, row = block(_B_BIT, _B_BIT, _B_BIT, _K_BIT)
    points[CLASS, i] = code_bit(state, data, model, (a + before, b + 2 + twice, c + 6, row), np.int64(points[CLASS, i]))


@borrowing
def _code_column(state, data, model, scales, points, i, now):
    """As columns since the last point: thinning leaves a certain distance in metres, so the range says how many."""
    before = np.int64(points[COLUMN, i - 1]) if now[_N] > 0 else np.int64(0)
    under = now[_UNDER]
    spacing = points[COLUMN, under + 1] - points[COLUMN, under] if under + 1 < now[_BELOW_END] else 0
    a = _B_GAP + min(level(now[_GAP]), 23)
    b = _B_GAP + 24 + min(level((max(now[_U], 0) * scales[WIDTH]) >> 14), 29)
    c = _B_GAP + 54 + min(level(spacing), 23)
    gap = code_number(state, data, model, block(a, b, c, _K_GAP), points[COLUMN, i] - before, False)
    now[_GAP_BEFORE], now[_GAP] = now[_GAP], gap
    column = before + gap
    points[COLUMN, i] = min(column, 65535)
    return column


@borrowing
def _code_late(state, data, model, points, i, now):
    """The correction of the time. Where a scan begins and ends the same jump occurs in every ring."""
    column = points[COLUMN, i]
    seam = 1 if column - now[_GAP] <= now[_LATE_AT] + 2 and column >= now[_LATE_AT] - 2 else 0
    a, b, c, row = block(_B_BIT, _B_BIT, _B_BIT, _K_SEAM)
    late = np.int64(points[LATE, i])
    if code_bit(state, data, model, (a + 8 + seam, b + 10 + seam, c + 12 + seam, row), 1 if late != 0 else 0):
        where = block(_B_LATE, _B_LATE + 1, _B_LATE + 2, _K_LATE)
        late = now[_LATE_BEFORE] + code_number(state, data, model, where, late - now[_LATE_BEFORE], True)
        now[_LATE_AT], now[_LATE_BEFORE] = column, late
    else:
        late = np.int64(0)
    points[LATE, i] = now[_LATE] = late
    return abs(late) <= _LATEST


@borrowing
def _look_below(points, column, now):
    """Range and intensity of the ring below at a column: of the nearest point, or between two on one surface."""
    end, under = now[_BELOW_END], now[_UNDER]
    if end == now[_BELOW]:
        now[_NEAR], now[_NEAR_SHADE] = now[_U], 8
        return
    while under + 1 < end and points[COLUMN, under + 1] <= column:
        under += 1
    now[_UNDER] = under
    u, shade = np.int64(points[ALONG, under]), np.int64(points[INTENSITY, under])
    left = column - points[COLUMN, under]
    if left > 0 and under + 1 < end:
        right = points[COLUMN, under + 1] - column
        next_u = np.int64(points[ALONG, under + 1])
        if right < left:
            shade = np.int64(points[INTENSITY, under + 1])
        if abs(next_u - u) < (u >> 3):
            u = (u * right + next_u * left) // (left + right)
        elif right < left:
            u = next_u
    now[_NEAR], now[_NEAR_SHADE] = u, shade


@borrowing
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
    a = _B_ALONG + min(level(least >> 3), 19) * 6 + min(level(gap) >> 1, 5)
    b = _B_ALONG + 120 + (20 + apart if p2 > expected else 20 - apart)
    c = _B_ALONG + 160 + min(level(now[_REST]), 30)
    rest = code_number(state, data, model, block(a, b, c, _K_ALONG), points[ALONG, i] - expected, True)
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


@borrowing
def _weight(error):
    return (1 << 30) // ((error + 8) * (error + 8))


@borrowing
def _judge(now, guess, error):
    """The running error of a guess, in sixteenths of a step."""
    e = now[_ERROR + guess]
    now[_ERROR + guess] = min(e + (((abs(error) << 4) - e) >> 2), 1 << 12)


@borrowing
def _code_across(state, data, model, scales, points, i, now):
    """The azimuth within the column. Beams stand on a lattice that drifts through the columns; its phase is narrowed
    to what the coded points allow. Without a lattice the middle of the column is expected."""
    width, expected = now[_U] * scales[WIDTH], np.int64(0)
    if scales[LATTICE]:
        _advance(points[COLUMN, i], scales, now)
        expected = ((now[_PHASE] >> 4) * width + (1 << 35)) >> 36
    a = _B_ACROSS + min(level(max(width, 0) >> 18), 29)
    b = _B_ACROSS + 30 + min(level(now[_ACROSS_SIZE]), 19)
    where = block(a, b, _B_ACROSS + 50, _K_ACROSS)
    rest = code_number(state, data, model, where, points[ACROSS, i] - expected, True)
    v = expected + rest
    points[ACROSS, i] = min(max(v, -LARGEST - 1), LARGEST + 1)
    now[_ACROSS_SIZE] = (now[_ACROSS_SIZE] + 2 * abs(rest) + 1) >> 1
    if rest != 0 and width > 0:
        edge = min(max(2 * v - (1 if rest > 0 else -1), -(1 << 22)), 1 << 22)
        now[_PHASE] = min(max((edge << 39) // width, -(TURN >> 1)), TURN >> 1)
    if now[_N] == 0:
        now[_PHASE_START], now[_COLUMN_START] = now[_PHASE], points[COLUMN, i]


@borrowing
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


@borrowing
def _code_up(state, data, model, line, points, i, now):
    """The elevation: a line in the range, which is what a beam that does not start in the origin looks like."""
    u = now[_U]
    expected = ((line[0] << 12) + line[1] * u + (1 << 13)) >> 14
    a = _B_UP + min(level(now[_UP_SIZE]), 14)
    b = _B_UP + 15 + min(level(abs(u)) >> 1, 19)
    rest = code_number(state, data, model, block(a, b, _B_UP + 35, _K_UP), points[UP, i] - expected, True)
    now[_UP_SIZE] = (now[_UP_SIZE] + 2 * abs(rest) + 1) >> 1
    points[UP, i] = min(max(expected + rest, -LARGEST - 1), LARGEST + 1)


@borrowing
def _code_shade(state, data, model, points, i, now):
    """The intensity, 0 to 15; False when it is not."""
    shade, near = np.int64(points[INTENSITY, i - 1]) if now[_N] > 0 else np.int64(8), now[_NEAR_SHADE]
    a = _B_SHADE + shade
    b = _B_SHADE + 16 + min(abs(near - shade), 7) + (8 if near < shade else 0)
    where = block(a, b, _B_SHADE + 32, _K_SHADE)
    shade += code_number(state, data, model, where, points[INTENSITY, i] - shade, True)
    points[INTENSITY, i] = min(max(shade, 0), 15)
    return 0 <= shade <= 15
