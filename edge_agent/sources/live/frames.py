"""Columns of a spinning sensor that numbers its turns, put together to frames (Ouster)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

_IDS = 2**16
_PATIENCE = 2  # packets of the next frame that are waited for, should one of this come late
_RESTART = 50  # frames: the sensor counts anew


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """One packet. frame: number of its turn. place: (C,) int64, column of the frame. stamps_ns: (C,) int64.

    valid: (C,) bool. range_mm: (rings, C) uint32, 0 without a return. reflectivity: (rings, C), unsigned.
    """

    frame: int
    place: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    valid: NDArray[np.bool_]
    range_mm: NDArray[np.unsignedinteger]
    reflectivity: NDArray[np.unsignedinteger]


@dataclass(slots=True, eq=False)
class Frame:
    """A turn, as far as it came: as Columns, with all columns; what did not come is not valid, and its range 0."""

    number: int
    stamps_ns: NDArray[np.int64]
    valid: NDArray[np.bool_]
    range_mm: NDArray[np.uint32]
    reflectivity: NDArray[np.uint16]
    seen: set[int] = field(default_factory=set)  # first columns of its packets

    @staticmethod
    def empty(number: int, rings: int, columns: int) -> Frame:
        return Frame(
            number,
            np.zeros(columns, dtype=np.int64),
            np.zeros(columns, dtype=bool),
            np.zeros((rings, columns), dtype=np.uint32),
            np.zeros((rings, columns), dtype=np.uint16),
        )

    def put(self, columns: Columns) -> None:
        """One packet; each place once."""
        place = columns.place
        self.seen.add(int(place[0]))
        self.stamps_ns[place], self.valid[place] = columns.stamps_ns, columns.valid
        self.range_mm[:, place] = np.where(columns.valid, columns.range_mm, 0)
        self.reflectivity[:, place] = columns.reflectivity


class Frames:
    """Packets in, frames out: complete ones at once, others when the next frame has begun.

    counts: packets by what became of them: used, duplicate, late (their frame is gone), start (of a frame whose
    beginning nobody saw), foreign (no such column), and besides, reordered (used, but came late) and lost.
    """

    def __init__(self, rings: int, columns: int, packets: int, first_column: int, counts: Counter[str]) -> None:
        """packets: of a frame. first_column: where the sensor's field of view begins."""
        self._rings, self._columns, self._packets, self._first_column = rings, columns, packets, first_column
        self.counts = counts
        self._open: list[Frame] = []  # this one and, perhaps, the next
        self._done: Frame | None = None
        self._begun = False  # the start of a frame was seen

    def add(self, columns: Columns) -> list[Frame]:
        """The frames that this packet completes, none or one mostly."""
        if int(columns.place.max()) >= self._columns or int(columns.place.min()) < 0:
            self.counts["foreign"] += 1
            return []
        done = self.flush() if self._restarted(columns.frame) else []
        frame = self._frame(columns)
        if frame is None:
            return done
        if int(columns.place[0]) in frame.seen:
            self.counts["duplicate"] += 1
            return done
        if frame is not self._open[-1] or any(place > columns.place[0] for place in frame.seen):
            self.counts["reordered"] += 1
        frame.put(columns)
        while self._open and (len(self._open[0].seen) >= self._packets or self._is_over()):
            done += self._finish(self._open.pop(0))
        return done

    def flush(self) -> list[Frame]:
        """What has begun, when nothing more comes."""
        done: list[Frame] = []
        while self._open:
            done += self._finish(self._open.pop(0))
        return done

    def _restarted(self, number: int) -> bool:
        newest = self._open[-1] if self._open else self._done
        if newest is None or abs(_ahead(number, newest.number)) < _RESTART:
            return False
        self._begun = False
        return True

    def _frame(self, columns: Columns) -> Frame | None:
        """Where the packet belongs; None when that is gone."""
        for frame in self._open:
            if frame.number == columns.frame:
                return frame
        newest = self._open[-1] if self._open else self._done
        if newest is not None and _ahead(columns.frame, newest.number) <= 0:
            twice = newest.number == columns.frame and int(columns.place[0]) in newest.seen
            self.counts["duplicate" if twice else "late"] += 1
            return None
        self._open.append(Frame.empty(columns.frame, self._rings, self._columns))
        return self._open[-1]

    def _is_over(self) -> bool:
        """The next frame has come as far as a late packet of this one could."""
        return len(self._open) > 1 and (len(self._open) > 2 or len(self._open[1].seen) >= _PATIENCE)

    def _finish(self, frame: Frame) -> list[Frame]:
        before, self._done = self._done, frame
        if not self._begun:
            self._begun = True
            if self._first_column not in frame.seen:
                self.counts["start"] += len(frame.seen)
                return []
        elif before is not None:
            self.counts["lost"] += (_ahead(frame.number, before.number) - 1) * self._packets
        self.counts["lost"] += self._packets - len(frame.seen)
        self.counts["used"] += len(frame.seen)
        return [frame]


def _ahead(number: int, of: int) -> int:
    """How many turns later, across the wrap of 16 bits."""
    return (number - of + _IDS // 2) % _IDS - _IDS // 2
