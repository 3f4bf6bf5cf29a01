"""sensor_msgs/PointCloud2 in the layouts drivers write: one table view of the bytes, fields found by name.

Velodyne: x y z intensity ring time (float32 s). Ouster: t (uint32 ns), ring (uint8), reflectivity, organised.
Hesai and Robosense: timestamp (float64 s since the epoch), ring. Livox: timestamp (float64 ns), line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitslam.errors import DataError

_FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
RING_FIELDS = ("ring", "channel", "line", "laser_id", "ring_id")
TIME_FIELDS = ("time", "t", "timestamp", "time_stamp", "offset_time", "timeoffset", "time_offset")
INTENSITY_FIELDS = ("intensity", "reflectivity", "i", "signal")


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The points of one message, message order (organised clouds row by row), N = height x width.

    points_lidar: (N, 3) float32, m. ring, time, intensity: (N,) in the message's own type, or None.
    """

    points_lidar: NDArray[np.float32]
    ring: NDArray[Any] | None
    time: NDArray[Any] | None
    intensity: NDArray[Any] | None


def read_table(message: Any) -> Table:
    """PointCloud2 -> Table. DataError `decode` when the layout contradicts itself, `empty` without points.

    Handles any field order and padding, row padding, big-endian data and float64 coordinates.
    """
    height, width = int(message.height), int(message.width)
    if height * width == 0:
        raise DataError("empty", "no points")
    view = _view(message, height, width)
    names = {name.lower(): name for name in view.dtype.names or ()}
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise DataError("decode", f"PointCloud2 has no field {missing[0]}; fields: {', '.join(names.values())}")
    points = np.empty((height * width, 3), dtype=np.float32)
    for axis, name in enumerate("xyz"):
        with np.errstate(over="ignore"):
            points[:, axis] = view[names[name]].reshape(-1)

    def column(candidates: tuple[str, ...]) -> NDArray[Any] | None:
        found = next((names[name] for name in candidates if name in names), None)
        if found is None:
            return None
        values = view[found].reshape(-1)
        return np.ascontiguousarray(values.astype(values.dtype.newbyteorder("="), copy=False))

    return Table(points, column(RING_FIELDS), column(TIME_FIELDS), column(INTENSITY_FIELDS))


def _view(message: Any, height: int, width: int) -> NDArray[Any]:
    """(height, width) structured view of the message's bytes, no copy."""
    step = int(message.point_step)
    row_step = int(message.row_step) if height > 1 else step * width
    order = ">" if message.is_bigendian else "<"
    names, formats, offsets = [], [], []
    for field in message.fields:
        kind = _FORMATS.get(int(field.datatype))
        if kind is None or field.name in names or int(field.count) > 1:
            continue  # not a number per point: nothing we read
        if field.offset + np.dtype(kind).itemsize > step:
            raise DataError("decode", f"field {field.name} ends after point_step {step}")
        names.append(field.name)
        formats.append(order + kind)
        offsets.append(int(field.offset))
    data = np.ascontiguousarray(message.data).view(np.uint8)
    if step == 0 or row_step < step * width or len(data) < (height - 1) * row_step + width * step:
        raise DataError("decode", f"{len(data)} bytes cannot hold {height} x {width} points of {step} bytes")
    dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    return np.ndarray((height, width), dtype=dtype, buffer=data, strides=(row_step, step))


class IntensityScale:
    """Intensity of any type -> uint8. Floats that never exceed 1 in the first scan are a 0..1 scale."""

    def __init__(self) -> None:
        self._factor: float | None = None

    def __call__(self, values: NDArray[Any] | None, n: int) -> NDArray[np.uint8]:
        """(N,) any number or None -> (N,) uint8, rounded, clipped to 0..255, NaN as 0."""
        if values is None:
            return np.zeros(n, dtype=np.uint8)
        if values.dtype == np.uint8:
            return values
        with np.errstate(over="ignore", invalid="ignore"):
            numbers = np.nan_to_num(values.astype(np.float32), nan=0.0, posinf=255.0, neginf=0.0)
        numbers = np.clip(numbers, 0.0, 255.0)
        if self._factor is None:
            unit = values.dtype.kind == "f" and 0.0 < numbers.max(initial=0.0) <= 1.0
            self._factor = 255.0 if unit else 1.0
        return np.clip(np.rint(numbers * np.float32(self._factor)), 0, 255).astype(np.uint8)
