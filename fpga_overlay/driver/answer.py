"""The logic's answer checked and unpacked into an ordered image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_agent.features.integer import FeatureMarks, Limits
from fpga_overlay.driver import _kernels as kernels
from fpga_overlay.driver.errors import AcceleratorError
from fpga_overlay.golden import packet
from fpga_overlay.golden.packet import BYPASS_FEATURES, HEADER_BEATS, TRAILER_BEATS, Beats, Header


@dataclass(frozen=True, slots=True, eq=False)
class AcceleratedImage:
    """A scan's image by ring, then column; M points. The arrays are views that the next scan overwrites.

    points_lidar: (M, 3) float32, m, deskewed to the scan's reference time. ring: (M,) uint8. column: (M,) uint16.
    source: (M,) int32, index into the scan. ring_start: (rings + 1,) int32: ring r is [r]:[r + 1]. marks: of the M
    points. duplicates: points dropped because their cell was taken; outside: because their ring does not exist;
    invalid: because they are not finite, at the origin or beyond 512 m.
    """

    points_lidar: NDArray[np.float32]
    ring: NDArray[np.uint8]
    column: NDArray[np.uint16]
    source: NDArray[np.int32]
    ring_start: NDArray[np.int32]
    marks: FeatureMarks
    duplicates: int
    outside: int
    invalid: int

    def __len__(self) -> int:
        return len(self.points_lidar)


def most_beats(points: int, cells: int) -> int:
    """The longest answer to a scan of so many points."""
    return HEADER_BEATS + points + (min(points, cells) + 1) // 2 + TRAILER_BEATS


def is_stale(answer: Beats, sequence: int) -> bool:
    """Whether this is an answer to an earlier request: it came too late for that one."""
    if len(answer) < HEADER_BEATS or int(answer[0, 0]) >> 16 != packet.MAGIC:
        return False
    return 0 < (sequence - int(answer[0, 3])) % 2**32 < 2**31


class AnswerReader:
    """Reads the answers of one sensor into buffers that are allocated once."""

    def __init__(self, rings: int, columns: int, limits: Limits) -> None:
        cells = rings * columns
        self._columns, self._limits = columns, limits
        self._points = np.empty((cells, 3), np.float32)
        self._ring, self._column = np.empty(cells, np.uint8), np.empty(cells, np.uint16)
        self._source, self._ring_start = np.empty(cells, np.int32), np.empty(rings + 1, np.int32)
        self._marks = FeatureMarks(np.empty(cells, np.int32), np.empty(cells, np.uint8), np.empty(cells, np.uint8))
        self._counts = np.zeros(2, np.int64)
        self._cells = np.empty((rings, columns), np.int32)  # these three: for answers without records
        self._records, self._range = np.empty(cells, np.uint64), np.empty(cells, np.int32)

    def read(self, answer: Beats, header: Header, count: int) -> AcceleratedImage:
        """The image of a scan of `count` points. AcceleratorError (`answer`): this is not the answer to it."""
        trailer = self._check(answer, header, count)
        beats = answer[HEADER_BEATS : HEADER_BEATS + count]
        if header.flags & BYPASS_FEATURES:
            n = kernels.order_points(beats, self._cells, self._records)
            records = self._records[: max(n, 0)]
            duplicates = count - int(trailer[0, 2]) - n
        else:
            n, duplicates = int(trailer[1, 0]), int(trailer[1, 1])
            records = answer[HEADER_BEATS + count : -TRAILER_BEATS].reshape(-1).view(np.uint64)[:n]
        points, ring, column, source = self._points[:n], self._ring[:n], self._column[:n], self._source[:n]
        sound = n >= 0 and kernels.unpack_image(
            beats, records, self._columns, points, ring, column, source, self._ring_start
        )
        if not sound:
            raise AcceleratorError("answer", "records that are none")
        if header.flags & BYPASS_FEATURES:
            kernels.gather_ranges(beats, source, self._range[:n])
            marks = FeatureMarks.of(self._range[:n], column, self._ring_start, self._limits, self._marks)
        else:
            marks = FeatureMarks(self._marks.d[:n], self._marks.marks[:n], self._marks.sector[:n])
            kernels.unpack_marks(records, marks.d, marks.marks, marks.sector)
        self._counts[:] = 0
        if trailer[0, 2]:
            kernels.count_flags(beats, self._counts)
        invalid, outside = map(int, self._counts)
        return AcceleratedImage(points, ring, column, source, self._ring_start, marks, duplicates, outside, invalid)

    def _check(self, answer: Beats, header: Header, count: int) -> Beats:
        """The trailer, (2, 4), of an answer whose frame is right."""
        if len(answer) < HEADER_BEATS + TRAILER_BEATS:
            raise AcceleratorError("answer", f"{len(answer)} beats, expected at least 4")
        trailer = answer[-TRAILER_BEATS:]
        status, points, invalid, sequence = map(int, trailer[0])
        if status >> 8 != packet.MAGIC << 8 | packet.VERSION:
            raise AcceleratorError("answer", f"trailer {status:#010x}, expected magic {packet.MAGIC:#x}, version 1")
        if status & 0xFF:
            raise AcceleratorError("answer", f"status {status & 0xFF:#04x}")
        if not np.array_equal(answer[:HEADER_BEATS], header.beats()) or sequence != header.sequence:
            raise AcceleratorError("answer", f"sequence {sequence}, expected the header sent, {header.sequence}")
        records, duplicates = int(trailer[1, 0]), int(trailer[1, 1])
        expected = HEADER_BEATS + count + (records + 1) // 2 + TRAILER_BEATS
        if points != count or len(answer) != expected or invalid > count:
            raise AcceleratorError("answer", f"{points} points in {len(answer)} beats, expected {count} in {expected}")
        known = not header.flags & BYPASS_FEATURES
        if records > len(self._source) or (known and records + duplicates + invalid != count):
            raise AcceleratorError("answer", f"{records} records of {count} points")
        return trailer
