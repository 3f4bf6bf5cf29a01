"""Maps as PLY files, written while they arrive."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

_COUNT_DIGITS = 12
_POINT_BYTES = 16


def write_ply(path: Path, pieces: Iterable[bytes]) -> int:
    """Binary little-endian PLY of x y z (m, frame `map`) and intensity, float32; returns the number of points.

    pieces: points as they come from SessionService.StreamMap, 16 bytes each. One piece is in memory at a time.
    """
    count = 0
    with path.open("wb") as file:
        file.write(_header(0))
        for piece in pieces:
            if len(piece) % _POINT_BYTES:
                raise ValueError(f"a piece of {len(piece)} bytes: expected a multiple of {_POINT_BYTES}")
            file.write(piece)
            count += len(piece) // _POINT_BYTES
        file.seek(0)
        file.write(_header(count))
    return count


def _header(count: int) -> bytes:
    """Its length does not depend on `count`, so that it can be written over; readers take leading zeros."""
    properties = "".join(f"property float {name}\n" for name in ("x", "y", "z", "intensity"))
    return (
        "ply\nformat binary_little_endian 1.0\ncomment splitslam, frame map, metres\n"
        f"element vertex {count:0{_COUNT_DIGITS}d}\n{properties}end_header\n"
    ).encode("ascii")
