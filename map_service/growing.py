"""Arrays that grow by a row at a time: what is looked at as a whole at each keyframe must not be a list by then."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
_FIRST = 64


class GrowingArray:
    """Rows of one shape and dtype; `rows` is a view of them all, good until the next one is added."""

    def __init__(self, shape: tuple[int, ...] = (), dtype: type = np.float64) -> None:
        self._data = np.empty((_FIRST, *shape), dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, row: ArrayLike) -> None:
        """Adds one; a quarter more memory is taken when there is no room."""
        if self._count == len(self._data):
            more = np.empty((self._count + self._count // 4, *self._data.shape[1:]), self._data.dtype)
            more[: self._count] = self._data
            self._data = more
        self._data[self._count] = row
        self._count += 1

    @property
    def rows(self) -> NDArray:
        """(n, ...) view."""
        return self._data[: self._count]


class Poses(Sequence[Array]):
    """Poses (4, 4) float64 of things numbered 0, 1, 2, ...; one that is asked for is a copy."""

    def __init__(self, poses: Iterable[Array] = ()) -> None:
        self._table = GrowingArray((4, 4))
        for T in poses:
            self._table.append(T)

    def __len__(self) -> int:
        return len(self._table)

    @overload
    def __getitem__(self, index: int) -> Array: ...
    @overload
    def __getitem__(self, index: slice) -> list[Array]: ...
    def __getitem__(self, index: int | slice) -> Array | list[Array]:
        found = self._table.rows[index].copy()
        return list(found) if isinstance(index, slice) else found

    def __iter__(self) -> Iterator[Array]:
        return iter(self._table.rows.copy())

    def __array__(self, dtype: type | None = None, copy: bool | None = None) -> NDArray:
        return np.array(self._table.rows, dtype)

    def append(self, T: Array) -> None:
        self._table.append(T)

    @property
    def matrices(self) -> Array:
        """(n, 4, 4) view; who writes into it moves the poses."""
        return self._table.rows

    @property
    def positions_m(self) -> Array:
        """(n, 3) view."""
        return self._table.rows[:, :3, 3]
