"""Range image of a scan (paper, Image node; Algorithm 1, lines 9-14): ring x column, first return wins, raw range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_agent.features import _projection_kernels as kernels
from splitslam.scan import Scan


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """The scan's points by ring, then column; M points. The arrays are views that the next scan overwrites.

    points_lidar: (M, 3) float32, m. column: (M,) uint16. source: (M,) int32,
    each point's index in the scan, where the rest of it is. ring_start: (rings + 1,) int32: ring r is [r]:[r + 1].
    duplicates: points dropped because their cell was taken; outside: because their ring does not exist.
    range_q: (M,) int32, as seen, 1/1024 m, 1 to 2^18 - 1; None where the marks were made along with the image.
    """

    scan: Scan
    points_lidar: NDArray[np.float32]
    column: NDArray[np.uint16]
    source: NDArray[np.int32]
    ring_start: NDArray[np.int32]
    duplicates: int
    outside: int
    range_q: NDArray[np.int32] | None = None

    def __len__(self) -> int:
        return len(self.points_lidar)

    @property
    def ring(self) -> NDArray[np.uint8]:
        """(M,), a copy. Of the few points that become features, `features.select` takes it from the scan itself."""
        return self.scan.ring[self.source]


class Projector:
    """Projects scans of one sensor into buffers that are allocated once."""

    def __init__(self, rings: int, columns: int) -> None:
        """rings: 1 to 256; columns: even, up to 65534."""
        cells = rings * columns
        self._cells = np.empty((rings, columns), np.int32)
        self._points = np.empty((cells, 3), np.float32)
        self._range = np.empty(cells, np.int32)
        self._column = np.empty(cells, np.uint16)
        self._source = np.empty(cells, np.int32)
        self._ring_start = np.empty(rings + 1, np.int32)
        self._counts = np.zeros(2, np.int64)
        self._ranges = np.empty(cells, np.int32)  # in the scan's order, of as many points as came at most

    def project(self, scan: Scan, points_lidar: NDArray[np.float32] | None = None) -> Image:
        """The scan's image. points_lidar: (N, 3), where the scan's points are in it; None: as seen."""
        if len(self._ranges) < len(scan):
            self._ranges = np.empty(len(scan), np.int32)
        kernels.project(scan.points_lidar, scan.ring, self._cells, self._ranges[: len(scan)], self._counts)
        n = kernels.gather(
            self._cells,
            scan.points_lidar if points_lidar is None else points_lidar,
            self._ranges,
            self._points,
            self._range,
            self._column,
            self._source,
            self._ring_start,
        )
        return Image(
            scan=scan,
            points_lidar=self._points[:n],
            column=self._column[:n],
            source=self._source[:n],
            ring_start=self._ring_start,
            duplicates=int(self._counts[0]),
            outside=int(self._counts[1]),
            range_q=self._range[:n],
        )
