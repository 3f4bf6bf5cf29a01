"""The grid as Nav2's map server and ROS 1's load it: map.yaml and map.pgm."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from splitslam.errors import InputError
from splitslam.export.grid.evidence import FREE, OCCUPIED, Evidence
from splitslam.export.grid.ground import Ground
from splitslam.export.grid.settings import GridSettings
from splitslam.export.grid.spool import ViewSpool
from splitslam.maps import MapPiece

Array = NDArray[np.float64]
_PART = 512  # cells a side that are in memory at a time
_BORDER_CELLS = 2
_MOST_CELLS = 1 << 31
_PIXEL = np.array([205, 254, 0], np.uint8)  # by state: unknown, free, occupied
# 205 is 0.19608 occupied: with 0.196 it stays unknown, with Nav2's own default of 0.25 it would be free
_YAML = """image: {image}
mode: trinary
resolution: {resolution!r}
origin: [{x!r}, {y!r}, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


@dataclass(frozen=True, slots=True)
class Grid:
    """What was written. free, occupied: cells."""

    rows: int
    columns: int
    free: int
    occupied: int


def write_grid(
    yaml: Path,
    image: Path,
    image_name: str,
    pieces: Iterable[MapPiece],
    settings: GridSettings,
    made: Callable[[int, int], None] = lambda done, total: None,
) -> Grid:
    """Makes the grid part by part; image_name: what the YAML calls the image. made: told of parts done, of how many.

    Raises InputError for a map without keyframes, or one of more cells than readers can hold.
    """
    with tempfile.TemporaryDirectory(prefix=".splitslam-", dir=image.parent) as folder:
        spool = ViewSpool(Path(folder) / "views", pieces, settings.range_m)
        if not len(spool):
            raise InputError("a map without keyframes: expected at least one for an occupancy grid")
        cell_m = settings.resolution_m
        low = np.floor(spool.low / cell_m).astype(np.int64) - _BORDER_CELLS
        columns, rows = (np.floor(spool.high / cell_m).astype(np.int64) + 1 + _BORDER_CELLS - low).tolist()
        if rows * columns > _MOST_CELLS:
            fits_m = cell_m * np.sqrt(rows * columns / _MOST_CELLS)
            raise InputError(f"--resolution {cell_m:g}: {columns} x {rows} cells: expected {fits_m:.2f} m or more")
        ground = Ground(spool)
        with image.open("wb") as file:
            canvas = _Canvas(file, rows, columns)
            parts = [(r, c) for r in range(0, rows, _PART) for c in range(0, columns, _PART)]
            for done, (r, c) in enumerate(parts, start=1):
                shape = min(_PART, rows - r), min(_PART, columns - c)
                corner: Array = ((low + [c, r]) * cell_m).astype(np.float64)
                if near := _near(spool.sensors, corner, shape, settings):
                    evidence = Evidence(corner, shape, ground, settings)
                    for view in spool.views(near):
                        evidence.add(view)
                    canvas.put(evidence.states(), r, c)
                made(done, len(parts))
    x, y = (low * cell_m).tolist()
    yaml.write_text(_YAML.format(image=image_name, resolution=cell_m, x=round(x, 6), y=round(y, 6)), encoding="utf-8")
    return Grid(rows, columns, canvas.free, canvas.occupied)


def _near(sensors: Array, corner: Array, shape: tuple[int, int], settings: GridSettings) -> list[int]:
    """The views whose rays may reach a part."""
    high = corner + np.array(shape[::-1]) * settings.resolution_m
    away = np.maximum(np.maximum(corner - sensors[:, :2], sensors[:, :2] - high), 0.0)
    return np.flatnonzero(np.hypot(*away.T) <= settings.range_m + 1.0).tolist()


class _Canvas:
    """A binary PGM whose rectangles come in any order; row 0 of the grid is the image's last."""

    def __init__(self, file: BinaryIO, rows: int, columns: int) -> None:
        self._file, self._rows, self._columns = file, rows, columns
        self.free = self.occupied = 0
        header = b"P5\n%d %d\n255\n" % (columns, rows)
        file.write(header)
        self._start = len(header)
        unknown = bytes([_PIXEL[0]]) * columns
        for _ in range(rows):
            file.write(unknown)

    def put(self, states: NDArray[np.uint8], row: int, column: int) -> None:
        """states (R, C): from grid cell (row, column) on."""
        self.free += int((states == FREE).sum())
        self.occupied += int((states == OCCUPIED).sum())
        for i, line in enumerate(_PIXEL[states]):
            self._file.seek(self._start + (self._rows - 1 - row - i) * self._columns + column)
            self._file.write(line.tobytes())
