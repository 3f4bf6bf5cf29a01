"""PointCloud2 messages -> RawScan: the table, its times, rings and intensity put together."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_agent.sources.beams import elevation_rad, nearest_ring
from edge_agent.sources.point_time import PointClock, times_from_azimuth
from edge_agent.sources.pointcloud2 import IntensityScale, Table, read_table
from edge_agent.sources.raw import RawScan
from splitslam.errors import DataError
from splitslam.robot import Lidar


class CloudDecoder:
    """One stream of PointCloud2. `notes` says once what was assumed about its layout."""

    def __init__(self, lidar: Lidar) -> None:
        self._stamp = lidar.stamp
        self._period_ns = round(1e9 / lidar.rate_hz)
        self._clock = PointClock(lidar.stamp, self._period_ns)
        self._intensity = IntensityScale()
        self._notes: dict[str, None] = {}
        self.beam_elevations_rad: NDArray[np.float32] | None = None

    @property
    def notes(self) -> list[str]:
        """What was assumed so far, one line each."""
        return [*self._notes, *self._clock.notes]

    def __call__(self, message: Any) -> RawScan:
        """One message -> all its points. DataError `empty`, `decode` or `point_time`.

        Points without a ring get the nearest of `beam_elevations_rad`, which must be set by then.
        """
        table = read_table(message)
        ring = self._ring(table)
        header_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        points = table.points_lidar
        if table.time is None:
            self._notes["points have no time: it is taken from the azimuth, one turn a scan (less exact)"] = None
            t_ns = times_from_azimuth(points, ring, self._period_ns)
            end_ns = int(t_ns.max())
            stamp_ns = header_ns - (end_ns if self._stamp == "end" else 0)
            end_ns += stamp_ns
        else:
            times = self._clock(header_ns, table.time)
            stamp_ns, end_ns, t_ns = times.stamp_ns, times.end_ns, times.t_offset_ns
            if times.bad.any():
                points = points.copy()
                points[times.bad] = np.nan
        return RawScan(stamp_ns, end_ns, points, t_ns, ring, self._intensity(table.intensity, len(points)))

    def _ring(self, table: Table) -> NDArray[np.integer]:
        if table.ring is not None:
            if table.ring.dtype.kind != "f":
                return table.ring
            return np.nan_to_num(np.clip(table.ring, -1.0, 1e6), nan=-1.0).astype(np.int64)
        if self.beam_elevations_rad is None:
            raise DataError("decode", "points have no ring and beam elevations are not known")
        self._notes["points have no ring: it is taken from their elevation"] = None
        return nearest_ring(elevation_rad(table.points_lidar), self.beam_elevations_rad)
