"""Azimuth by CORDIC, as the deskew core's pipeline does it, and the column of the range image."""

from __future__ import annotations

import math

import numpy as np

from fpga_overlay.golden.fixed import Ints

ITERATIONS = 22
GUARD = 2
TURN_BITS = 27  # an angle is 2^-27 turns
ARCTANGENTS = [round(math.atan(2.0**-i) / (2 * math.pi) * (1 << TURN_BITS)) for i in range(ITERATIONS)]


def azimuth(x: Ints, y: Ints) -> Ints:
    """Angle of (x, y), signed 27 bits of a turn; 0 for the origin. x, y: signed 24 bits, above -2^23."""
    largest = np.maximum(np.abs(x), np.abs(y))
    shift = np.full_like(x, 0)
    for k in (16, 8, 4, 2, 1):  # normalised: bit 22 of the larger one is set
        small = (largest << shift) < 1 << (23 - k)
        shift = np.where(small, shift + k, shift)
    shift = np.minimum(shift, 22)
    behind = x < 0
    u = np.where(behind, -x, x) << shift << GUARD
    v = np.where(behind, -y, y) << shift << GUARD
    angle = np.where(behind, 1 << (TURN_BITS - 1), 0)
    for i, step in enumerate(ARCTANGENTS):
        below = v < 0
        du, dv = v >> i, u >> i
        u, v = np.where(below, u - du, u + du), np.where(below, v + dv, v - dv)
        angle = np.where(below, angle - step, angle + step)
    half = 1 << (TURN_BITS - 1)
    angle = ((angle + half) & ((1 << TURN_BITS) - 1)) - half
    return np.where(largest == 0, 0, angle)


def column_of(angle: Ints, columns: int) -> Ints:
    """LIO-SAM's column: grows counter-clockwise, +x in the middle, halves rounded away from zero."""
    v = angle * columns
    step = (np.abs(v) + (1 << (TURN_BITS - 1))) >> TURN_BITS
    column = columns // 2 + np.where(v < 0, -step, step)
    return np.where(column >= columns, column - columns, column)
