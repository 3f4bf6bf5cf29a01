"""An array that rows are appended to."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_ROOM = 64


class Growing:
    """Appending costs the same however long it is. What was handed out keeps its values."""

    def __init__(self, shape: tuple[int, ...] = (), dtype: DTypeLike = np.float64) -> None:
        """shape: of one row."""
        self._data = np.empty((_ROOM, *shape), dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def values(self) -> NDArray[Any]:
        """(n, *shape), not to be written to."""
        return self._data[: self._count]

    def append(self, row: Any) -> None:
        if self._count == len(self._data):
            self._data = np.concatenate([self._data, np.empty_like(self._data)])
        self._data[self._count] = row
        self._count += 1

    def replace(self, rows: NDArray[Any]) -> None:
        """New values for all rows (n, *shape)."""
        if rows.shape != self.values.shape:
            raise ValueError(f"rows {rows.shape}: expected {self.values.shape}")
        data = np.empty_like(self._data)
        data[: self._count] = rows
        self._data = data
