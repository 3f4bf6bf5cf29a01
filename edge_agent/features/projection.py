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

    points_lidar: (M, 3) float32, m; as seen when they come from the projector. ring: (M,) uint8. column: (M,) uint16.
    t_offset_ns: (M,) int32. intensity: (M,) uint8. ring_start: (rings + 1,) int32: ring r is [r]:[r + 1].
    duplicates: points dropped because their cell was taken; outside: because their ring does not exist.
    range_q: (M,) int32, as seen, 1/1024 m, 1 to 2^18 - 1; None where the marks were made along with the image.
    """

    points_lidar: NDArray[np.float32]
    ring: NDArray[np.uint8]
    column: NDArray[np.uint16]
    t_offset_ns: NDArray[np.int32]
    intensity: NDArray[np.uint8]
    ring_start: NDArray[np.int32]
    duplicates: int
    outside: int
    range_q: NDArray[np.int32] | None = None

    def __len__(self) -> int:
        return len(self.points_lidar)


class Projector:
    """Projects scans of one sensor into buffers that are allocated once."""

    def __init__(self, rings: int, columns: int) -> None:
        """rings: 1 to 256; columns: even, up to 65534."""
        cells = rings * columns
        self._cells = np.empty((rings, columns), np.int32)
        self._points = np.empty((cells, 3), np.float32)
        self._range = np.empty(cells, np.int32)
        self._column = np.empty(cells, np.uint16)
        self._source = np.empty(cells, np.intp)
        self._ring_start = np.empty(rings + 1, np.int32)
        self._counts = np.zeros(2, np.int64)
        self._ring = np.empty(cells, np.uint8)
        self._time = np.empty(cells, np.int32)
        self._intensity = np.empty(cells, np.uint8)

    def project(self, scan: Scan) -> Image:
        """The scan's image."""
        kernels.project(scan.points_lidar, scan.ring, self._cells, self._counts)
        n = kernels.gather(
            self._cells,
            scan.points_lidar,
            self._points,
            self._range,
            self._column,
            self._source,
            self._ring_start,
        )
        source = self._source[:n]  # mode: "raise" would go by a copy
        return Image(
            points_lidar=self._points[:n],
            ring=np.take(scan.ring, source, out=self._ring[:n], mode="clip"),
            column=self._column[:n],
            t_offset_ns=np.take(scan.t_offset_ns, source, out=self._time[:n], mode="clip"),
            intensity=np.take(scan.intensity, source, out=self._intensity[:n], mode="clip"),
            ring_start=self._ring_start,
            duplicates=int(self._counts[0]),
            outside=int(self._counts[1]),
            range_q=self._range[:n],
        )
