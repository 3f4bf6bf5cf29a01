"""A way piece by piece: what is logged again when a pose is added is its newest piece, however long the way is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LONGEST = 100  # points of a piece
_STEP_M = 0.02  # a robot that stands draws nothing


class Piece:
    """The newest piece of a way, in whatever frame its points come."""

    def __init__(self) -> None:
        self._points: list[Array] = []

    @property
    def points(self) -> Array:
        """(N, 3) m."""
        return np.array(self._points).reshape(-1, 3)

    def add(self, point: Array) -> bool:
        """False: the point (3,) is where the robot was before."""
        if self._points and np.linalg.norm(point - self._points[-1]) < _STEP_M:
            return False
        self._points.append(point)
        return True

    def taken(self) -> list[Array]:
        """The piece, if it is a line; the next one begins where it ends."""
        points, self._points = self.points, self._points[-1:]
        return [points] if len(points) > 1 else []

    def begin(self) -> None:
        """Anew, somewhere else."""
        self._points = []

    @property
    def full(self) -> bool:
        return len(self._points) > LONGEST
