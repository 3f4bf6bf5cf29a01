"""Fixed-point formats of the cores and the operations on them, elementwise on int64 arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]

POINT_BITS = 24  # signed, 2^-14 m: +-512 m in steps of 0.06 mm
POINT_FRACTION = 14
ROTATION_FRACTION = 25  # of 27 bits, signed
TRANSLATION_FRACTION = 18  # of 27 bits, signed, m
SLOPE_SHIFT = 20  # a slope is 2^-20 of its base's unit, per tick
MATRIX_BITS = 27
DT_BITS = 17  # ticks within a segment, saturating
RANGE_FRACTION = 10  # 18 bits, unsigned, saturating at 256 m
RANGE_BITS = 18


def wrap(value: Ints, bits: int) -> Ints:
    """Two's complement of that many bits."""
    half = 1 << (bits - 1)
    return ((value + half) & ((1 << bits) - 1)) - half


def from_float32(value: NDArray[np.float32]) -> tuple[Ints, NDArray[np.bool_]]:
    """(2^-14 m, rounded half away from zero; fits), 0 where the value is not finite or too large."""
    with np.errstate(invalid="ignore", over="ignore"):
        magnitude = np.floor(np.abs(value.astype(np.float64)) * (1 << POINT_FRACTION) + 0.5)
        fits = magnitude < 1 << (POINT_BITS - 1)  # false for NaN
    q = np.where(fits, magnitude, 0).astype(np.int64)
    return np.where(np.signbit(value), -q, q), fits


def range_of(x: Ints, y: Ints, z: Ints) -> Ints:
    """floor(sqrt((x^2 + y^2 + z^2) / 256)): the range in 1/1024 m, saturating."""
    s = (x * x + y * y + z * z) >> 2 * (POINT_FRACTION - RANGE_FRACTION)
    return np.minimum(np.sqrt(s.astype(np.float64)).astype(np.int64), (1 << RANGE_BITS) - 1)  # exact below 2^52
