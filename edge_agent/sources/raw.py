"""A decoded LiDAR message before any gate, and the step that makes a `Scan` of it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.errors import DataError
from splitslam.robot import Robot
from splitslam.scan import Scan

_MAX_SPAN_NS = 2_000_000_000  # offsets travel as int32


@dataclass(frozen=True, slots=True, eq=False)
class RawScan:
    """All returns of one message, sensor order.

    stamp_ns: first firing; end_ns: last firing. points_lidar: (N, 3) float32, m, NaN and zeros still in.
    t_offset_ns: (N,) int64 after stamp_ns. ring: (N,) integer. intensity: (N,) uint8.
    """

    stamp_ns: int
    end_ns: int
    points_lidar: NDArray[np.float32]
    t_offset_ns: NDArray[np.int64]
    ring: NDArray[np.integer]
    intensity: NDArray[np.uint8]
    native_bytes: int = 0


class Gate:
    """Keeps the points a scan may use and counts the others by reason in `left_out`."""

    def __init__(self, robot: Robot, left_out: Counter[str]) -> None:
        self._rings, self._point_times = robot.lidar.rings, robot.lidar.point_times
        self._min_sq = np.float32(robot.lidar.min_range_m**2)
        self._max_sq = np.float32(robot.lidar.max_range_m**2)
        self._boxes = [np.array(box, dtype=np.float32).reshape(2, 3) for box in robot.lidar.crop_boxes_body]
        self._T_body_lidar = robot.T_body_lidar.astype(np.float32)
        self._left_out = left_out

    def __call__(self, raw: RawScan) -> Scan:
        """RawScan -> Scan; DataError `empty`, `nan` or `point_time` when nothing usable is left."""
        if not 0 <= raw.end_ns - raw.stamp_ns <= _MAX_SPAN_NS:
            raise DataError("point_time", f"points of one scan span {(raw.end_ns - raw.stamp_ns) * 1e-9:.3f} s")
        p = raw.points_lidar
        with np.errstate(over="ignore", invalid="ignore"):
            range_sq = p[:, 0] * p[:, 0] + p[:, 1] * p[:, 1] + p[:, 2] * p[:, 2]
        finite = np.isfinite(range_sq)
        zero = range_sq == 0
        inside = (range_sq >= self._min_sq) & (range_sq <= self._max_sq)  # False for NaN and zero
        known = (raw.ring >= 0) & (raw.ring < self._rings)
        keep = inside & known
        n_finite, n_zero = int(np.count_nonzero(finite)), int(np.count_nonzero(zero))
        self._count("nan", len(p) - n_finite)
        self._count("zero", n_zero)
        self._count("gated", n_finite - n_zero - int(np.count_nonzero(inside & finite)))
        self._count("unknown_ring", int(np.count_nonzero(inside & ~known)))
        if self._boxes:
            keep = self._crop(p, keep)
        if not keep.any():
            raise DataError("nan" if len(p) and n_finite == 0 else "empty")
        t_ns, index = raw.t_offset_ns, np.flatnonzero(keep)
        if self._point_times == "mirrored":  # the order of the points is that of time, so that turns round as well
            t_ns, index = raw.end_ns - raw.stamp_ns - t_ns, index[::-1]
        elif self._point_times == "one_moment":
            t_ns = np.zeros_like(t_ns)
        return Scan(
            stamp_ns=raw.stamp_ns,
            end_ns=raw.end_ns,
            points_lidar=np.ascontiguousarray(p[index]),
            t_offset_ns=t_ns[index].astype(np.int32),
            ring=raw.ring[index].astype(np.uint8),
            intensity=raw.intensity[index],
            read_points=n_finite - n_zero,
            native_bytes=raw.native_bytes,
        )

    def _crop(self, points_lidar: NDArray[np.float32], keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
        index = np.flatnonzero(keep)
        points_body = points_lidar[index] @ self._T_body_lidar[:3, :3].T + self._T_body_lidar[:3, 3]
        in_box = np.zeros(len(index), dtype=bool)
        for low, high in self._boxes:
            in_box |= ((points_body >= low) & (points_body <= high)).all(axis=1)
        self._count("cropped", int(in_box.sum()))
        keep = keep.copy()
        keep[index[in_box]] = False
        return keep

    def _count(self, name: str, n: int) -> None:
        if n:
            self._left_out[name] += n
