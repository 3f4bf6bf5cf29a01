"""Bytes as they should not be."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

Rng = np.random.Generator
_EDGES = (0, 1, 0x7F, 0x80, 0xFF)


def mutated(seeds: Sequence[bytes], rng: Rng) -> bytes:
    """One of the seeds, changed in one to four places."""
    data = bytearray(seeds[rng.integers(len(seeds))])
    other = seeds[rng.integers(len(seeds))]
    for _ in range(rng.integers(1, 5)):
        _WAYS[rng.integers(len(_WAYS))](data, other, rng)
    return bytes(data)


def _flip(data: bytearray, other: bytes, rng: Rng) -> None:
    if data:
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))


def _edge(data: bytearray, other: bytes, rng: Rng) -> None:
    """One to eight bytes in a row, as sizes and counts have their extremes."""
    if data:
        at, n = int(rng.integers(len(data))), int(rng.choice((1, 2, 4, 8)))
        data[at : at + n] = bytes([_EDGES[rng.integers(len(_EDGES))]]) * min(n, len(data) - at)


def _noise(data: bytearray, other: bytes, rng: Rng) -> None:
    at = int(rng.integers(len(data) + 1))
    noise = rng.integers(0, 256, rng.integers(1, 64)).astype(np.uint8).tobytes()
    data[at : at + (len(noise) if rng.random() < 0.5 else 0)] = noise


def _cut(data: bytearray, other: bytes, rng: Rng) -> None:
    a, b = sorted(int(i) for i in rng.integers(0, len(data) + 1, 2))
    del data[a : b if rng.random() < 0.5 else len(data)]


def _repeat(data: bytearray, other: bytes, rng: Rng) -> None:
    a, b = sorted(int(i) for i in rng.integers(0, len(data) + 1, 2))
    b = min(b, a + 256)
    data[b:b] = data[a:b] * int(rng.integers(1, 4))


def _splice(data: bytearray, other: bytes, rng: Rng) -> None:
    at = int(rng.integers(len(data) + 1))
    data[at:] = other[int(rng.integers(len(other) + 1)) :]


_WAYS: tuple[Callable[[bytearray, bytes, Rng], None], ...] = (_flip, _flip, _edge, _noise, _cut, _repeat, _splice)
