"""Packets for the tests: random and awkward ones, and what a core must answer to any, sound or not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fpga_overlay.golden import deskew, packet
from fpga_overlay.golden.fixed import DT_BITS, MATRIX_BITS, ROTATION_FRACTION, TRANSLATION_FRACTION
from fpga_overlay.golden.packet import Beats, Header

SIZES = ((16, 1800), (64, 1024), (128, 2048))  # rings, columns
LAST_TICK = (1 << 24) - 1
Table = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Packet:
    """A sound packet by its parts. table: (S, 28) int32; points: (N, 4) uint32."""

    header: Header
    table: Table
    points: Beats

    def beats(self) -> Beats:
        return packet.request(self.header, self.table, self.points)

    def answer(self) -> Beats:
        """Of the deskew core."""
        return deskew.answer(self.header, self.table, self.points)


def random_packet(
    rng: np.random.Generator, points: int, segments: int, size: tuple[int, int] = SIZES[0], **header: int
) -> Packet:
    """A motion such as robots have, in pieces of random length, and points all around; a few are unusable."""
    first = Header(*size, segments=segments, sequence=int(rng.integers(1 << 32)), **header)
    span = int(rng.integers(1_000, LAST_TICK))
    table = motion(rng, breaks(rng, segments, span))
    xyz = rng.normal(0, 30, (points, 3)).astype(np.float32)
    xyz[rng.random(points) < 0.02] = np.nan
    ring = rng.integers(0, size[0] + 1, points).astype(np.uint8)
    return Packet(first, table, packet.point_beats(xyz, ring, rng.integers(0, span, points).astype(np.int32)))


def breaks(rng: np.random.Generator, segments: int, span: int) -> NDArray[np.int32]:
    """(S,) increasing first ticks below `span`."""
    return np.sort(rng.choice(span, segments, replace=False)).astype(np.int32)


def motion(rng: np.random.Generator, first_ticks: NDArray[np.int32]) -> Table:
    """A table with near-rotations, translations of metres, and slopes that change them visibly."""
    table = np.zeros((len(first_ticks), 28), np.int32)
    table[:, 0] = first_ticks
    matrix = rng.normal(0, 0.3, (len(first_ticks), 3, 4)) + np.eye(3, 4)
    scale = np.array([1 << ROTATION_FRACTION] * 3 + [1 << TRANSLATION_FRACTION])
    table[:, 4:16] = np.round(np.clip(matrix, -1.9, 1.9) * scale).reshape(-1, 12).astype(np.int32)
    table[:, 16:28] = rng.integers(-(1 << 20), 1 << 20, (len(first_ticks), 12))
    return table


def any_table(rng: np.random.Generator, first_ticks: NDArray[np.int32]) -> Table:
    """A table of which every 27-bit number is as likely as any other: sums wrap, points saturate."""
    table = np.zeros((len(first_ticks), 28), np.int32)
    table[:, 0] = first_ticks
    half = 1 << (MATRIX_BITS - 1)
    table[:, 4:28] = rng.integers(-half, half, (len(first_ticks), 24))
    return table


def points_at(xyz: object, ring: object = 0, tick: object = 0) -> Beats:
    """(N, 4) from whatever broadcasts: (N, 3) m, rings, ticks."""
    xyz = np.atleast_2d(np.asarray(xyz, np.float32))
    return packet.point_beats(
        xyz,
        np.broadcast_to(np.asarray(ring, np.uint8), len(xyz)),
        np.broadcast_to(np.asarray(tick, np.int32), len(xyz)),
    )


def ticks_around(first_ticks: NDArray[np.int32]) -> NDArray[np.int32]:
    """Before, at and after every break, where dt saturates, and the ends of time."""
    far = first_ticks.astype(np.int64)[:, None] + [-1, 0, 1, (1 << DT_BITS) - 1, 1 << DT_BITS, (1 << DT_BITS) + 1]
    return np.unique(np.clip(np.append(far, [0, LAST_TICK]), 0, LAST_TICK)).astype(np.int32)


def refusal(beats: Beats, status: int) -> Beats:
    """The answer to a bad packet: its header as far as it came, and a trailer that says why."""
    out = np.zeros((packet.HEADER_BEATS + packet.TRAILER_BEATS, 4), np.uint32)
    head = beats[: packet.HEADER_BEATS]
    out[: len(head)] = head
    out[packet.HEADER_BEATS] = [packet.MAGIC << 16 | packet.VERSION << 8 | status, 0, 0, head[0, 3]]
    return out


def with_header(beats: Beats, **changes: int) -> Beats:
    """A packet that lies: header fields (magic, version, those of Header) changed and nothing else."""
    beats = beats.copy()
    magic, version = changes.pop("magic", packet.MAGIC), changes.pop("version", packet.VERSION)
    w = [int(word) for word in beats[0]]
    header = Header(
        rings=w[2] & 255,
        columns=w[2] >> 16,
        segments=w[1] & 0xFFFF,
        sectors=w[1] >> 16,
        sequence=w[3],
        flags=w[0] & 255,
    )
    beats[0] = replace(header, **changes).beats()[0]
    beats[0, 0] = magic << 16 | version << 8 | int(beats[0, 0]) & 255
    return beats
