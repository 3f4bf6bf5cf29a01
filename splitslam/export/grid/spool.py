"""Pieces of a map on disk: a grid is made in several passes over one and the same state of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitslam.maps import MapPiece

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What one keyframe saw: sensor (3,) and points (N, 3) float64, m, `map`; in the order of the scan's rings."""

    number: int
    sensor: Array
    points: Array


class ViewSpool:
    """Written once, read as often as wanted. low, high: (2,) bounds of sensors and points within range, m, `map`."""

    def __init__(self, path: Path, pieces: Iterable[MapPiece], range_m: float) -> None:
        """path: to be made. Points further than `range_m` from their sensor do not widen the bounds."""
        self._path = path
        sensors, counts = [], []
        self.low, self.high = np.full(2, np.inf), np.full(2, -np.inf)
        with path.open("wb") as file:
            for piece in pieces:
                sensor, points = piece.T_map_lidar[:3, 3], piece.points_map[:, :3].astype("<f4")
                near = points[np.hypot(*(points[:, :2] - sensor[:2]).T) <= range_m, :2]
                for corner in (near, sensor[None, :2]):
                    if len(corner):
                        self.low, self.high = np.minimum(self.low, corner.min(0)), np.maximum(self.high, corner.max(0))
                file.write(points.tobytes())
                sensors.append(sensor)
                counts.append(len(points))
        self.sensors = np.array(sensors).reshape(-1, 3)
        self._ends = np.cumsum(counts, dtype=np.int64) if counts else np.zeros(0, np.int64)

    def __len__(self) -> int:
        return len(self.sensors)

    def views(self, numbers: Iterable[int] | None = None) -> Iterator[View]:
        """All of them, or those of these numbers (0 and up), one at a time."""
        with self._path.open("rb") as file:
            for k in range(len(self)) if numbers is None else numbers:
                start = int(self._ends[k - 1]) if k else 0
                file.seek(start * 12)
                points = np.fromfile(file, "<f4", 3 * (int(self._ends[k]) - start)).reshape(-1, 3)
                yield View(k, self.sensors[k], points.astype(np.float64))
