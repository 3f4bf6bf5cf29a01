"""Maps as PLY files, written while they arrive and read part by part."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitslam.errors import InputError

_COUNT_DIGITS = 12
_POINT_BYTES = 16
_AT_ONCE = 100_000
_MAX_HEADER_BYTES = 64 << 10
_EXPECTED = "expected binary little-endian PLY of float x, y, z, intensity"
_FIELDS = tuple(f"property float {name}" for name in ("x", "y", "z", "intensity"))


def write_ply(
    path: Path, pieces: Iterable[bytes], comments: tuple[str, ...] = ("splitslam, frame map, metres",)
) -> int:
    """Binary little-endian PLY of x y z (m, frame `map`) and intensity, float32; returns the number of points.

    pieces: points as they come from SessionService.StreamMap, 16 bytes each. One piece is in memory at a time.
    """
    count = 0
    with path.open("wb") as file:
        file.write(_header(0, comments))
        for piece in pieces:
            if len(piece) % _POINT_BYTES:
                raise ValueError(f"a piece of {len(piece)} bytes: expected a multiple of {_POINT_BYTES}")
            file.write(piece)
            count += len(piece) // _POINT_BYTES
        file.seek(0)
        file.write(_header(count, comments))
    return count


def read_points(path: Path) -> NDArray[np.float32]:
    """(N, 4) x y z intensity of a map that write_ply has written, mapped into memory, not read. Raises InputError."""
    count, offset = _read_header(path)
    if path.stat().st_size < offset + count * _POINT_BYTES:
        raise InputError(f"{path}: expected {count} points, found the file shorter")
    return np.memmap(path, "<f4", "r", offset, (count, 4)) if count else np.empty((0, 4), np.float32)


def read_ply(path: Path) -> Iterator[NDArray[np.float32]]:
    """A map that write_ply has written, (N, 4) at a time: x y z m, intensity. Raises InputError for any other file."""
    count, offset = _read_header(path)
    left = count
    with path.open("rb") as file:
        file.seek(offset)
        while left > 0:
            data = file.read(_POINT_BYTES * min(left, _AT_ONCE))
            if len(data) < _POINT_BYTES * min(left, _AT_ONCE):
                raise InputError(f"{path}: {left} of {count} points are missing at its end")
            yield np.frombuffer(data, "<f4").reshape(-1, 4)
            left -= len(data) // _POINT_BYTES


def _read_header(path: Path) -> tuple[int, int]:
    """How many points there are, and at which byte they begin."""
    try:
        with path.open("rb") as file:
            text, end, _ = file.read(_MAX_HEADER_BYTES).partition(b"end_header\n")
    except OSError as error:
        raise InputError(f"{path}: {_EXPECTED} ({error.strerror})") from None
    lines = text.decode("ascii", "replace").splitlines()
    counts = [line.split()[-1] for line in lines if line.startswith("element vertex ")]
    fields = tuple(line for line in lines if line.startswith("property "))
    binary = "format binary_little_endian 1.0" in lines
    if not (end and binary and fields == _FIELDS and len(counts) == 1 and counts[0].isdigit()):
        raise InputError(f"{path}: {_EXPECTED}")
    return int(counts[0]), len(text) + len(end)


def _header(count: int, comments: tuple[str, ...]) -> bytes:
    """Its length does not depend on `count`, so that it can be written over; readers take leading zeros."""
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {' '.join(said.split())}" for said in comments)]
    lines += [f"element vertex {count:0{_COUNT_DIGITS}d}", *_FIELDS, "end_header"]
    return ("\n".join(lines) + "\n").encode("ascii", "replace")
