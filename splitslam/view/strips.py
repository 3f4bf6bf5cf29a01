"""A way as a row of short strips: what is logged again when a pose is added is one strip, however long the way is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LONGEST = 50  # points of a strip
_STEP_M = 0.02  # a robot that stands draws nothing


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """The newest strip of a way: its number and its points (N, 3), m."""

    number: int
    points: Array


class Strips:
    """Of one way, in whatever frame its points come."""

    def __init__(self) -> None:
        self._number = -1
        self._points: list[Array] = []

    def add(self, point: Array) -> Strip | None:
        """The strip that the point (3,) has changed; None when the robot has not moved since the last one."""
        if self._points and np.linalg.norm(point - self._points[-1]) < _STEP_M:
            return None
        if not self._points or len(self._points) >= LONGEST:
            self._number += 1
            self._points = self._points[-1:]  # a strip begins where the one before ended
        self._points.append(point)
        return Strip(self._number, np.array(self._points))
