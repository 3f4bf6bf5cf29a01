"""PLY and PCD: float32 coordinates less an offset, which the header names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from splitslam.export.placing import Placing
from splitslam.maps import MapPiece
from splitslam.ply import write_ply

_COUNT_DIGITS = 12


def write_ply_cloud(path: Path, pieces: Iterable[MapPiece], placing: Placing, name: str) -> int:
    """Binary PLY; returns the number of points."""
    offset = "offset {!r} {!r} {!r}".format(*placing.offset_m.tolist())
    return write_ply(path, _records(pieces, placing), (f"splitslam, {placing.description}", offset, f"session {name}"))


def write_pcd_cloud(path: Path, pieces: Iterable[MapPiece], placing: Placing, name: str) -> int:
    """Binary PCD 0.7; returns the number of points."""
    count = 0
    with path.open("wb") as file:
        file.write(_pcd_header(0, placing, name))
        for record in _records(pieces, placing):
            file.write(record)
            count += len(record) // 16
        file.seek(0)
        file.write(_pcd_header(count, placing, name))
    return count


def _records(pieces: Iterable[MapPiece], placing: Placing) -> Iterator[bytes]:
    for piece in pieces:
        points = piece.points_map.astype("<f4", copy=True)
        points[:, :3] = placing.place(piece.points_map[:, :3].astype(np.float64)) - placing.offset_m
        yield points.tobytes()


def _pcd_header(count: int, placing: Placing, name: str) -> bytes:
    """Its length does not depend on `count`, so that it can be written over; readers take leading zeros."""
    offset = "{!r} {!r} {!r}".format(*placing.offset_m.tolist())
    number = f"{count:0{_COUNT_DIGITS}d}"
    lines = (
        "# .PCD v0.7 - Point Cloud Data file format",
        f"# splitslam, {placing.description}; offset {offset}; session {' '.join(name.split())}",
        "VERSION 0.7",
        "FIELDS x y z intensity",
        "SIZE 4 4 4 4",
        "TYPE F F F F",
        "COUNT 1 1 1 1",
        f"WIDTH {number}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {number}",
        "DATA binary",
    )
    return ("\n".join(lines) + "\n").encode("ascii", "replace")
