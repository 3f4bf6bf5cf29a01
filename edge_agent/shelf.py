"""Frames in one place, memory or disk, in the order in which they would have to go: sparse ones first, oldest first."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Container


class Shelf:
    """Sizes of frames by seq, ascending."""

    def __init__(self) -> None:
        self._sparse: OrderedDict[int, int] = OrderedDict()
        self._dense: OrderedDict[int, int] = OrderedDict()
        self.bytes = 0

    def __len__(self) -> int:
        return len(self._sparse) + len(self._dense)

    def __contains__(self, seq: int) -> bool:
        return seq in self._sparse or seq in self._dense

    def add(self, seq: int, size: int, dense: bool) -> None:
        """Puts a frame there that is newer than the others of its kind."""
        (self._dense if dense else self._sparse)[seq] = size
        self.bytes += size

    def remove(self, seq: int) -> None:
        """Takes a frame away, if it is there."""
        self.bytes -= self._sparse.pop(seq, 0) or self._dense.pop(seq, 0)

    def oldest(self) -> int | None:
        """The lowest seq."""
        return min((next(iter(kind)) for kind in (self._sparse, self._dense) if kind), default=None)

    def victim(self, spared: Container[int]) -> int | None:
        """The frame that is missed least, None when all are `spared`."""
        return next((seq for kind in (self._sparse, self._dense) for seq in kind if seq not in spared), None)
