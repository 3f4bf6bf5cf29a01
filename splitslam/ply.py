"""Maps as PLY files, written while they arrive."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitslam.errors import InputError

_COUNT_DIGITS = 12
_POINT_BYTES = 16
_END = b"end_header\n"
_SAME_BYTES = 36  # the first two lines


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


def read_points(path: Path) -> NDArray[np.float32]:
    """(N, 4) x y z intensity of a map.ply of ours, mapped into memory, not read. Raises InputError."""
    try:
        with path.open("rb") as file:
            header = file.read(1024)
    except OSError as error:
        raise InputError(f"{path}: expected a map as `splitslam run` writes it ({error.strerror})") from None
    if not header.startswith(_header(0)[:_SAME_BYTES]) or _END not in header:
        raise InputError(f"{path}: expected a map as `splitslam run` writes it: binary, x y z intensity")
    offset = header.index(_END) + len(_END)
    count = (path.stat().st_size - offset) // 16
    if count == 0:
        return np.empty((0, 4), np.float32)
    return np.memmap(path, "<f4", "r", offset, (count, 4))


def _header(count: int) -> bytes:
    """Its length does not depend on `count`, so that it can be written over; readers take leading zeros."""
    properties = "".join(f"property float {name}\n" for name in ("x", "y", "z", "intensity"))
    return (
        "ply\nformat binary_little_endian 1.0\ncomment splitslam, frame map, metres\n"
        f"element vertex {count:0{_COUNT_DIGITS}d}\n{properties}end_header\n"
    ).encode("ascii")
