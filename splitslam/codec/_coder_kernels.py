"""Kernels of the entropy coder: an adaptive binary range coder that mixes three predictions of each bit.

Integers only, so that every machine decodes what any other has encoded. The same functions encode and decode: the
coder's state says which, and a value that goes in while encoding comes out while decoding. Arrays of a coder, apart
because compiled functions pass arrays faster than tuples of them:

state: (6,) int64, see the names below. data: (N,) uint8, the bytes. model: (WEIGHTS + contexts,) int32: three weights
for each of the rows, 1/65536; then for every context the probability of a one, 1/65536, times 256, plus how often it
was met.

Range coder with carry propagation as in LZMA (Martin, Range encoding, 1979); predictions are mixed in the logistic
domain (Mahoney, Adaptive weighing of context models, 2005).
"""

from __future__ import annotations

import numpy as np

from splitslam.codec._jit import borrowing
from splitslam.codec.logistic import RATE, SQUASH, STRETCH

LOW, RANGE, CACHE, PENDING, POSITION, DECODING = range(6)  # while decoding LOW holds the code
BLOCK = 96  # contexts that one number takes
ROWS = 8  # rows of weights that one number takes
KINDS = 16  # of numbers, each with weights of its own
WEIGHTS = KINDS * 3 * ROWS
SPARED = 5  # bytes that the decoder may read beyond the end
_TOP = 1 << 24
_ALL = (1 << 32) - 1
_LEAST = 48  # of 65536: no bit is ever certain
_LIMIT = 60  # a context that was met so often forgets: it follows what changes in a frame
_LEARNING = 6
_HEAVIEST = 1 << 19
_LONGEST = 30  # bits of a number


@borrowing
def start(state, data, model, decoding):
    """Begin to encode into data, or to decode them."""
    state[:] = 0
    state[RANGE], state[DECODING] = _ALL, decoding
    model[:WEIGHTS] = 24_000
    model[WEIGHTS:] = 1 << 23
    if decoding:
        for _ in range(4):
            state[LOW] = (state[LOW] << 8) | _next_byte(state, data)
    else:
        state[POSITION] = -1  # the first byte out is always 0 and is left out


@borrowing
def finish(state, data):
    """The number of bytes encoded, all written out; zeros at the end are left to the decoder, up to five."""
    # the value in [low, low + range) with the most zeros at its end
    for bits in range(32, -1, -1):
        value = ((state[LOW] + (1 << bits) - 1) >> bits) << bits
        if value < state[LOW] + state[RANGE]:
            state[LOW] = value
            break
    for _ in range(5):
        _shift(state, data)
    n = least = state[POSITION]
    while n > 0 and n > least - SPARED and data[n - 1] == 0:
        n -= 1
    return n


@borrowing
def _next_byte(state, data):
    """The next byte, 0 after the end. `position` runs on, so that one can see how far beyond it went."""
    position = state[POSITION]
    state[POSITION] = position + 1
    return np.int64(data[position]) if position < len(data) else np.int64(0)


@borrowing
def _shift(state, data):
    """Moves the top byte of low out; bytes of 255 wait until it is known whether a carry runs through them."""
    low = state[LOW]
    if low < 0xFF000000 or low > _ALL:
        carry = low >> 32
        _put(state, data, state[CACHE] + carry)
        while state[PENDING] > 0:
            _put(state, data, 255 + carry)
            state[PENDING] -= 1
        state[PENDING] = 0
        state[CACHE] = (low >> 24) & 255
    else:
        state[PENDING] += 1
    state[LOW] = (low & 0xFFFFFF) << 8


@borrowing
def _put(state, data, byte):
    if 0 <= state[POSITION] < len(data):
        data[state[POSITION]] = byte & 255
    state[POSITION] += 1


@borrowing
def _narrow(state, data, bound, bit):
    """Codes a bit whose ones take the first `bound` of the range."""
    if state[DECODING]:
        bit = 1 if state[LOW] < bound else 0
        if bit:
            state[RANGE] = bound
        else:
            state[LOW] -= bound
            state[RANGE] -= bound
        while state[RANGE] < _TOP:
            state[LOW] = (state[LOW] << 8) | _next_byte(state, data)
            state[RANGE] <<= 8
        return bit
    if bit:
        state[RANGE] = bound
    else:
        state[LOW] += bound
        state[RANGE] -= bound
    while state[RANGE] < _TOP:
        _shift(state, data)
        state[RANGE] <<= 8
    return bit


@borrowing
def code_bits(state, data, value, count):
    """`count` bits of value >= 0, most significant first, each as likely as not."""
    result = np.int64(0)
    for k in range(count - 1, -1, -1):
        result = 2 * result + _narrow(state, data, state[RANGE] >> 1, (value >> k) & 1)
    return result


@borrowing
def code_bit(state, data, model, where, bit):
    """A bit that three contexts predict; all three and their weights learn from it.

    where: (a, b, c, row), three contexts and the row of weights, as indices into model.
    """
    a, b, c, row = where
    ma, mb, mc = np.int64(model[a]), np.int64(model[b]), np.int64(model[c])
    wa, wb, wc = np.int64(model[row]), np.int64(model[row + 1]), np.int64(model[row + 2])
    sa, sb, sc = np.int64(STRETCH[ma >> 12]), np.int64(STRETCH[mb >> 12]), np.int64(STRETCH[mc >> 12])
    dot = (wa * sa + wb * sb + wc * sc) >> 16
    p = np.int64(SQUASH[min(max(dot, -2047), 2047) + 2048])
    p = min(max(p, _LEAST), 65536 - _LEAST)
    bit = _narrow(state, data, (state[RANGE] >> 16) * p, bit)

    error = ((bit << 16) - p) * _LEARNING
    model[row] = min(max(wa + ((sa * error) >> 16), -_HEAVIEST), _HEAVIEST)
    model[row + 1] = min(max(wb + ((sb * error) >> 16), -_HEAVIEST), _HEAVIEST)
    model[row + 2] = min(max(wc + ((sc * error) >> 16), -_HEAVIEST), _HEAVIEST)
    model[a] = _learn(ma, bit)
    model[b] = _learn(mb, bit)
    model[c] = _learn(mc, bit)
    return bit


@borrowing
def _learn(context, bit):
    """A context after a bit: the more it has met, the less it moves, down to 1 / 61.5."""
    chance, seen = context >> 8, context & 255
    chance += ((65535 * bit - chance) * np.int64(RATE[seen])) >> 16
    return (chance << 8) | min(seen + 1, _LIMIT)


@borrowing
def bit_length(x):
    """Bits of x >= 0."""
    n = 0
    while x > 0:
        x >>= 1
        n += 1
    return n


@borrowing
def level(x):
    """Size of x >= 0 as a context: 0, 1, then two levels an octave."""
    if x <= 1:
        return max(x, 0)
    e = bit_length(x) - 1
    return 2 * e + ((x >> (e - 1)) & 1)


@borrowing
def code_number(state, data, model, where, value, signed):
    """An integer below 2^30 in size: zero, sign, exponent, two bits of mantissa in context, the rest as they are.

    where: (a, b, c, row), the first of BLOCK contexts each and of ROWS weights each, as block(...) makes them.
    """
    size = abs(value)
    if not code_bit(state, data, model, where, 1 if size > 0 else 0):
        return np.int64(0)
    negative = code_bit(state, data, model, _beside(where, 1, 1), 1 if value < 0 else 0) if signed else 0
    length, e = bit_length(size) - 1, 0
    while e < _LONGEST - 1:
        if not code_bit(state, data, model, _beside(where, 2 + e, 2 + min(e, 3)), 1 if length > e else 0):
            break
        e += 1
    result = np.int64(1)
    if e >= 1:
        result = 2 + code_bit(state, data, model, _beside(where, 31 + e, 6), (size >> (e - 1)) & 1)
    if e >= 2:
        k = 60 + 2 * min(e, 16) + (result & 1)
        result = 2 * result + code_bit(state, data, model, _beside(where, k, 7), (size >> (e - 2)) & 1)
    if e >= 3:
        rest = code_bits(state, data, size & ((1 << (e - 2)) - 1), e - 2)
        result = (result << (e - 2)) | rest
    return -result if negative else result


@borrowing
def block(a, b, c, kind):
    """Where numbers of a kind live: the start of three blocks of contexts and of the kind's rows of weights."""
    return WEIGHTS + a * BLOCK, WEIGHTS + b * BLOCK, WEIGHTS + c * BLOCK, kind * 3 * ROWS


@borrowing
def _beside(where, context, row):
    a, b, c, w = where
    return a + context, b + context, c + context, w + 3 * row


@borrowing
def code_numbers(state, data, model, context, kind, values):
    """values (N,) int64, signed, each in the same contexts, sharper after small ones; filled while decoding."""
    before = 0
    for i in range(len(values)):
        beside = context + 1 + min(level(before), 8)
        values[i] = code_number(state, data, model, block(context, beside, beside, kind), values[i], True)
        before = abs(values[i])


@borrowing
def code_fields(state, data, values, widths):
    """values (N,) int64 >= 0 of widths (N,) bits, as they are."""
    for i in range(len(values)):
        values[i] = code_bits(state, data, values[i], widths[i])
