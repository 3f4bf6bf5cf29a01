"""Kernels of the entropy coder: an adaptive binary range coder that adds up what four contexts say of each bit.

Integers only, so that every machine decodes what any other has encoded. The same functions encode and decode: the
coder's state says which, and a value that goes in while encoding comes out while decoding. Arrays of a coder, apart
because compiled functions pass arrays faster than tuples of them:

state: (STATE,) int64, see the names below. data: (N,) uint8, the bytes. model: (contexts,) int32: for each context the
logarithm of the odds that it gives a one, 2^-16, times 64, plus how often it was met.

The chance of a bit is the logistic function of the sum of its contexts, and each of them learns from the error of the
sum: logistic regression, one bit at a time. A range coder with a wide range (Martin, Range encoding, 1979) puts three
bytes out at a time, and adds a carry to those that are out.
"""

from __future__ import annotations

import numpy as np

from splitslam.codec._jit import borrowing, inlined
from splitslam.codec.levels import LEVEL
from splitslam.codec.logistic import RATE, SQUASH

LOW, RANGE, POSITION, DECODING = range(4)  # while decoding LOW holds the code, less what LOW would be
STATE = 4
SPARED = 10  # bytes that the decoder may read beyond the end
_WHOLE, _LEAST = 1 << 56, 1 << 32  # of the range
_MET = 63  # a context that was met so often learns no slower: it follows what changes in a frame

# contexts of a number: its sign; has it as many bits as guessed; has it k bits, from below; from above; the second and
# the third of its bits, by how many there are
_SIGN, _GUESS, _FROM_BELOW, _FROM_ABOVE, _SECOND, _THIRD = 0, 0, 11, 27, 37, 41
BLOCK = 64  # contexts that one number takes
MOST_GUESSED = 12  # bits
_LONGEST = 30  # bits


@borrowing
def start(state, data, model, decoding):
    """Begin to encode into data, or to decode them."""
    state[LOW], state[RANGE], state[POSITION], state[DECODING] = 0, _WHOLE, 0, decoding
    model[:] = 0
    if decoding:
        _take(state, data, 7)


@borrowing
def finish(state, data):
    """The number of bytes encoded, all written out; zeros at the end are left to the decoder, up to SPARED."""
    # the value in [low, low + range) with the most zeros at its end
    for bits in range(56, -1, -1):
        value = ((state[LOW] + (1 << bits) - 1) >> bits) << bits
        if value < state[LOW] + state[RANGE]:
            state[LOW] = value
            break
    for _ in range(3):
        _put(state, data)
    n = least = state[POSITION]
    while n > 0 and n > least - SPARED and data[n - 1] == 0:
        n -= 1
    return n


@borrowing
def _put(state, data):
    """Moves the top three bytes of low out; a carry runs through those that are out already."""
    low, position = state[LOW], state[POSITION]
    if low >= _WHOLE:
        k = position - 1
        while data[k] == 255:
            data[k] = 0
            k -= 1
        data[k] += 1
    if position + 3 <= len(data):
        data[position] = (low >> 48) & 255
        data[position + 1] = (low >> 40) & 255
        data[position + 2] = (low >> 32) & 255
    state[POSITION] = position + 3
    state[LOW] = (low & (_LEAST - 1)) << 24


@borrowing
def _take(state, data, count):
    """The next bytes, 0 after the end. `position` runs on, so that one can see how far beyond it went."""
    position = state[POSITION]
    for k in range(position, position + count):
        state[LOW] = (state[LOW] << 8) | (np.int64(data[k]) if k < len(data) else 0)
    state[POSITION] = position + count


@borrowing
def _widen(state, data):
    """After the range has become small."""
    state[RANGE] <<= 24
    if state[DECODING]:
        _take(state, data, 3)
    else:
        _put(state, data)


@inlined
def narrow(state, data, bound, bit):
    """Codes a bit whose ones take the first `bound` of the range."""
    whole, low = state[RANGE], state[LOW]
    if state[DECODING]:
        bit = 1 if low < bound else 0
        state[LOW] = low if bit else low - bound
    else:
        state[LOW] = low if bit else low + bound
    left = bound if bit else whole - bound
    state[RANGE] = left
    if left < _LEAST:
        _widen(state, data)
    return bit


@borrowing
def code_bits(state, data, value, count):
    """`count` bits of value >= 0, up to 31, each as likely as not."""
    result = np.int64(0)
    while count > 0:
        now = min(count, 16)
        count -= now
        share = state[RANGE] >> now
        if state[DECODING]:
            part = min(state[LOW] // share, (1 << now) - 1)
            state[LOW] -= part * share
        else:
            part = (value >> count) & ((1 << now) - 1)
            state[LOW] += part * share
        state[RANGE] = share
        if share < _LEAST:
            _widen(state, data)
        result = (result << now) | part
    return result


@inlined
def code_bit(state, data, model, where, node, bit):
    """A bit that four contexts predict. where: four blocks of contexts, as block(...) makes them; node: which of each.

    Indices are unsigned, which spares the code for negative ones. A context of a frame that was made to mislead may
    wrap around: it does so on both sides.
    """
    a, b, c, d = where
    a, b, c, d = np.uint64(a + node), np.uint64(b + node), np.uint64(c + node), np.uint64(d + node)
    of_a, of_b, of_c, of_d = np.int64(model[a]), np.int64(model[b]), np.int64(model[c]), np.int64(model[d])
    odds = ((of_a >> 6) + (of_b >> 6) + (of_c >> 6) + (of_d >> 6)) >> 8
    chance = np.int64(SQUASH[(min(max(odds, -2047), 2047) + 2048) & 4095])
    bit = narrow(state, data, (state[RANGE] >> 16) * chance, bit)
    error = (bit << 16) - chance
    model[a] = _learnt(of_a, error)
    model[b] = _learnt(of_b, error)
    model[c] = _learnt(of_c, error)
    model[d] = _learnt(of_d, error)
    return bit


@inlined
def _learnt(context, error):
    """A context after an error, 2^-16: the more it has met, the less it moves."""
    met = context & 63
    return (((context >> 6) + ((error * np.int64(RATE[met])) >> 16)) << 6) | min(met + 1, _MET)


@inlined
def level(x):
    """Size of x as a context: 0 up to 0, then 1, then two levels an octave, up to 43."""
    x = max(x, 0)
    return np.int64(LEVEL[x & 4095]) if x < 4096 else 20 + np.int64(LEVEL[min(x >> 10, 4095)])


@inlined
def bits_of(x):
    """Bits that x takes, as a guess for code_number: 1 to 12."""
    return min(max((level(x) >> 1) + 1, 1), MOST_GUESSED)


@inlined
def code_number(state, data, model, where, value, signed, guess, modelled):
    """An integer below 2^30 in size: its bits, from as many as guessed (1 to MOST_GUESSED) up or down; its sign.

    Of the bits after the first, `modelled` (0 to 2) are in context, the others as they are.
    """
    size, k = abs(value), guess
    first = more = code_bit(state, data, model, where, _GUESS + k, 1 if size >> (k - 1) else 0)
    while more == first:
        k += 1 if first else -1
        if k == 0 or k > _LONGEST:
            break
        node = _FROM_BELOW + min(k, 16) if first else _FROM_ABOVE + k
        more = code_bit(state, data, model, where, node, 1 if size >> (k - 1) else 0)
    if first:
        k -= 1
    if k == 0:
        return np.int64(0)

    negative = code_bit(state, data, model, where, _SIGN, 1 if value < 0 else 0) if signed else np.int64(0)
    result, left = np.int64(1), k - 1
    if modelled > 0 and left > 0:
        left -= 1
        result = 2 + code_bit(state, data, model, where, _SECOND + min(k, 9), (size >> left) & 1)
    if modelled > 1 and left > 0:
        left -= 1
        node = _THIRD + 2 * min(k, 9) + (result & 1)
        result = 2 * result + code_bit(state, data, model, where, node, (size >> left) & 1)
    if left > 0:
        result = (result << left) | code_bits(state, data, size & ((1 << left) - 1), left)
    return -result if negative else result


@inlined
def block(a, b, c, d):
    """Where numbers of a kind live: the starts of four blocks of contexts."""
    return a * BLOCK, b * BLOCK, c * BLOCK, d * BLOCK


@inlined
def code_flag(state, data, model, where, bit):
    """A bit in contexts of its own."""
    return code_bit(state, data, model, where, 0, bit)


@borrowing
def code_numbers(state, data, model, context, values):
    """values (N,) int64, signed, each in the same contexts, sharper after small ones; filled while decoding.

    context: the first of ten blocks.
    """
    before = np.int64(0)
    for i in range(len(values)):
        beside = context + 1 + min(level(before), 8)
        where = block(context, beside, beside, context)
        values[i] = code_number(state, data, model, where, values[i], True, 1, 2)
        before = abs(values[i])


@borrowing
def code_fields(state, data, values, widths):
    """values (N,) int64 >= 0 of widths (N,) bits, as they are."""
    for i in range(len(values)):
        values[i] = code_bits(state, data, values[i], widths[i])
