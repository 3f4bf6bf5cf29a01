"""Kernel of map thinning."""

from __future__ import annotations

import numpy as np
from numba import njit

FASTMATH = {"contract", "arcp", "nsz"}
EMPTY = 0xFFFFFFFF


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def take(keys, table, first):
    """Puts keys (N,) uint32 into a hash table; first (N,) bool: which were not in it. Returns how many those are.

    table: (2^n,) uint32, EMPTY where nothing is, never full; a key goes to the first free place from its hash on
    (linear probing; Knuth, The Art of Computer Programming 3, 6.4; the multiplier is 2^32 over the golden ratio).
    """
    mask = len(table) - 1
    taken = 0
    for k in range(len(keys)):
        key = np.int64(keys[k])
        mixed = (key * 2654435769) & 0xFFFFFFFF
        at = (mixed ^ (mixed >> 15)) & mask
        while table[at] != EMPTY and table[at] != key:
            at = (at + 1) & mask
        first[k] = table[at] == EMPTY
        if first[k]:
            table[at] = key
            taken += 1
    return taken
