"""The packets that go to the programmable logic and come back: one DMA pair a scan, everything in band.

A beat is 128 bits, four little-endian 32-bit words w0 (bits 31:0) to w3. Arrays of beats are (B, 4) uint32.

To the logic: 2 header beats, 7 beats for every segment of the motion, 1 beat for every point; TLAST on the last.

| beat | w0 | w1 | w2 | w3 |
|---|---|---|---|---|
| header 0 | magic 31:16, version 15:8, flags 7:0 | segments 15:0, sectors 19:16 | rings 7:0, columns 27:16 | sequence |
| header 1 | occlusion 17:0 | corner 21:0 | flat 21:0 | 0 |
| segment 0 | first tick 23:0 | 0 | 0 | 0 |
| segment 1-3 | base, row-major 3x4, a row each |
| segment 4-6 | slope, the same |
| point | x float32 | y float32 | z float32 | ring 31:24, tick 23:0 |

Back: the 2 header beats as they came, 1 beat for every point, the records two a beat, 2 trailer beats; TLAST ends it.

| beat | w0 | w1 | w2 | w3 |
|---|---|---|---|---|
| point | x 31:8, ring 7:0 | y 31:8, column 7:0 | z 31:8, flags 7:4, column 11:8 (in 3:0) | range 17:0 |
| trailer 0 | magic 31:16, version 15:8, status 7:0 | points | invalid points | sequence |
| trailer 1 | records | duplicates | 0 | 0 |

A record is 64 bits, from bit 0 up: index 18 (of the point in it), column 11, ring 7, |d| 22, sector 3 (7: none),
masked 1, corner 1, flat 1. Records are ordered by ring, then column. Of an odd number the last beat's upper half is 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MAGIC, VERSION = 0x534C, 1
BYPASS_DESKEW, BYPASS_FEATURES = 1, 2
TRUNCATED, TOO_MANY_SEGMENTS, BAD_HEADER, BAD_GEOMETRY = 1, 2, 4, 8  # status; a packet with any has no records
POINT_VALID, POINT_UNUSABLE, POINT_RING_OUTSIDE = 1, 2, 4  # flags of a point
MAX_SEGMENTS, MAX_POINTS, MAX_RINGS, MAX_COLUMNS = 256, 1 << 18, 128, 2048
NO_SECTOR = 7
HEADER_BEATS, SEGMENT_BEATS, TRAILER_BEATS = 2, 7, 2

Beats = NDArray[np.uint32]  # (B, 4)


@dataclass(frozen=True, slots=True)
class Header:
    """The first two beats.

    occlusion: 1/1024 m. corner, flat: of |d|, 1/1024 m: a corner candidate is above, a flat one below.
    """

    rings: int
    columns: int
    segments: int = 0
    sequence: int = 0
    flags: int = 0
    sectors: int = 6
    occlusion: int = 307
    corner: int = 1024
    flat: int = 324

    def beats(self) -> Beats:
        """(2, 4)."""
        first = MAGIC << 16 | VERSION << 8 | self.flags
        words = [first, self.segments | self.sectors << 16, self.rings | self.columns << 16, self.sequence]
        return np.array([words, [self.occlusion, self.corner, self.flat, 0]], np.uint32)


def request(header: Header, table: NDArray[np.int32], points: Beats) -> Beats:
    """A packet to the logic. table: (S, 28) int32, S = header.segments: the words of each segment. points: (N, 4)."""
    return np.concatenate([header.beats(), table.view(np.uint32).reshape(-1, 4), points])


def point_beats(
    points_lidar: NDArray[np.float32], ring: NDArray[np.uint8], tick: NDArray[np.int32] | NDArray[np.uint32]
) -> Beats:
    """(N, 4) from (N, 3) m, (N,) and (N,) ticks after the scan's start."""
    beats = np.empty((len(points_lidar), 4), np.uint32)
    beats[:, :3] = np.ascontiguousarray(points_lidar, np.float32).view(np.uint32)
    beats[:, 3] = np.asarray(ring, np.uint32) << 24 | np.asarray(tick).astype(np.uint32) & 0xFFFFFF
    return beats
