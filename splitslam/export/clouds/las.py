"""LAS and LAZ 1.4, point format 6: coordinates in steps of 0.1 mm, intensity, GPS time."""

from __future__ import annotations

import errno
import importlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from laspy.point.record import PackedPointRecord
from laspy.vlrs.known import WktCoordinateSystemVlr

from splitslam.errors import InputError
from splitslam.export.gps_time import adjusted_gps_s
from splitslam.export.placing import Placing
from splitslam.maps import MapPiece

STEP_M = 1e-4  # 32 bits of it reach 214 km
INTENSITY = 256  # LAS wants 16 bits: 65,536 over the sensor's range (LAS 1.4 R15, table 9)
_FORMAT = 6


def las_header(placing: Placing) -> laspy.LasHeader:
    """Of an empty file in the frame of `placing`."""
    header = laspy.LasHeader(point_format=_FORMAT, version="1.4")
    header.scales, header.offsets = np.full(3, STEP_M), placing.offset_m
    header.generating_software = "splitslam"
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.global_encoding.wkt = True  # as format 6 must have it, with or without a reference system
    if placing.wkt:
        header.vlrs.append(WktCoordinateSystemVlr(placing.wkt))
    return header


def las_records(piece: MapPiece, placing: Placing) -> np.ndarray:
    """(N,) point records of format 6. Raises InputError for points too far from the offset."""
    records = np.zeros(len(piece.points_map), laspy.PointFormat(_FORMAT).dtype())
    placed = placing.place(piece.points_map[:, :3].astype(np.float64))
    steps = np.rint((placed - placing.offset_m) / STEP_M)
    if len(steps) and not np.abs(steps).max() <= np.iinfo(np.int32).max:
        raise InputError(f"keyframe {piece.keyframe}: more than 214 km from the map's origin: expected less for LAS")
    records["X"], records["Y"], records["Z"] = steps.astype(np.int32).T
    records["intensity"] = np.rint(piece.points_map[:, 3]).astype(np.uint16) * INTENSITY
    records["bit_fields"] = 0x11  # return 1 of 1
    if piece.stamp_ns:
        records["gps_time"] = adjusted_gps_s(np.array([piece.stamp_ns], np.int64))[0]
    return records


def write_las_cloud(path: Path, pieces: Iterable[MapPiece], placing: Placing, compress: bool) -> int:
    """Returns the number of points. Raises InputError as las_records does."""
    header = las_header(placing)
    backend = laspy.LazBackend.Lazrs if compress else None
    with path.open("wb") as file, lazrs_errors(path):
        writer = laspy.LasWriter(file, header, do_compress=compress, laz_backend=backend, closefd=False)
        for piece in pieces:
            if len(piece.points_map):
                records = las_records(piece, placing)
                writer.write_points(PackedPointRecord(records, header.point_format))
        writer.close()
        return writer.header.point_count


@contextmanager
def lazrs_errors(path: Path) -> Iterator[None]:
    """What lazrs says of a file that cannot be written is an OSError, as that of the file itself."""
    lazrs: Any = importlib.import_module("lazrs")  # compiled, without type information
    try:
        yield
    except lazrs.LazrsError as error:
        raise OSError(errno.EIO, f"LAZ: {error}", str(path)) from error
