"""The deskew core: deskewed point, range and column of every point, in the order in which the points come."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpga_overlay.golden import packet
from fpga_overlay.golden.cordic import azimuth, column_of
from fpga_overlay.golden.fixed import (
    DT_BITS,
    MATRIX_BITS,
    POINT_BITS,
    POINT_FRACTION,
    ROTATION_FRACTION,
    SLOPE_SHIFT,
    TRANSLATION_FRACTION,
    Ints,
    from_float32,
    range_of,
    wrap,
)
from fpga_overlay.golden.packet import Beats, Header


@dataclass(frozen=True, slots=True, eq=False)
class DeskewedPoints:
    """(N, 3) int64 in 2^-14 m; (N,) int64 ring, column, range in 1/1024 m; (N,) int64 flags of the packet's format."""

    points: Ints
    ring: Ints
    column: Ints
    range_q: Ints
    flags: Ints

    def beats(self) -> Beats:
        """(N, 4) as they leave the core."""
        low = np.column_stack([self.ring, self.column & 255, self.flags << 4 | self.column >> 8])
        words = np.column_stack([(self.points << 8 | low), self.range_q])
        return (words & 0xFFFFFFFF).astype(np.uint32)


def deskew(header: Header, table: NDArray[np.int32], points: Beats) -> DeskewedPoints:
    """What the core makes of a sound packet."""
    coordinates, fits = zip(*(from_float32(points[:, c].view(np.float32)) for c in range(3)), strict=True)
    x, y, z = coordinates
    ring = (points[:, 3] >> 24).astype(np.int64)
    tick = (points[:, 3] & 0xFFFFFF).astype(np.int64)
    range_q = range_of(x, y, z)
    usable = fits[0] & fits[1] & fits[2] & (range_q > 0)
    inside = ring < header.rings
    flags = np.where(usable & inside, packet.POINT_VALID, 0)
    flags |= np.where(usable, 0, packet.POINT_UNUSABLE) | np.where(inside, 0, packet.POINT_RING_OUTSIDE)
    column = column_of(azimuth(x, y), header.columns)
    moved = np.column_stack(coordinates)
    if len(table) and not header.flags & packet.BYPASS_DESKEW:
        moved = _moved(table, moved, tick)
    valid = flags & packet.POINT_VALID
    return DeskewedPoints(moved * valid[:, None], ring, column * valid, range_q * valid, flags)


def _moved(table: NDArray[np.int32], p: Ints, tick: Ints) -> Ints:
    breaks = table[:, 0].astype(np.int64)
    s = np.maximum(np.searchsorted(breaks, tick, side="right") - 1, 0)
    dt = np.clip(tick - breaks[s], 0, (1 << DT_BITS) - 1)
    base, slope = table[s, 4:16].astype(np.int64), table[s, 16:28].astype(np.int64)
    matrix = wrap(base + ((slope * dt[:, None] + (1 << (SLOPE_SHIFT - 1))) >> SLOPE_SHIFT), MATRIX_BITS).reshape(
        -1, 3, 4
    )
    translation = matrix[:, :, 3] << (ROTATION_FRACTION + POINT_FRACTION - TRANSLATION_FRACTION)
    total = (matrix[:, :, :3] * p[:, None, :]).sum(axis=2) + translation
    limit = (1 << (POINT_BITS - 1)) - 1
    return np.clip((total + (1 << (ROTATION_FRACTION - 1))) >> ROTATION_FRACTION, -limit, limit)


def answer(header: Header, table: NDArray[np.int32], points: Beats) -> Beats:
    """The packet that leaves the deskew core."""
    return answer_of(header, deskew(header, table, points))


def answer_of(header: Header, result: DeskewedPoints) -> Beats:
    """A result as the packet that leaves the deskew core."""
    points, valid = len(result.flags), int(np.count_nonzero(result.flags & packet.POINT_VALID))
    status = packet.MAGIC << 16 | packet.VERSION << 8
    trailer = np.array([[status, points, points - valid, header.sequence], [0, 0, 0, 0]], np.uint32)
    return np.concatenate([header.beats(), result.beats(), trailer])
