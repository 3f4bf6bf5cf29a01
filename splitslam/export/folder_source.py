"""What `splitslam run` left in a folder: the finished map and the trajectory, without keyframes and graph."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from splitslam.errors import InputError
from splitslam.maps import MapGraph, MapPiece
from splitslam.ply import read_ply
from splitslam.thinning import TakenVoxels
from splitslam.tum import Trajectory, read_tum


class FolderSource:
    """map.ply and trajectory.tum of one run."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def name(self) -> str:
        return self._folder.name

    @property
    def pieces_expected(self) -> int | None:
        return None

    @property
    def has_keyframes(self) -> bool:
        return False

    def pieces(self, voxel_m: float) -> Iterator[MapPiece]:
        """As MapSource; the pieces are parts of the file, their time and place is not known."""
        parts = read_ply(self._folder / "map.ply")
        if voxel_m == 0:
            for index, points in enumerate(parts):
                yield MapPiece(index, 0, np.eye(4), points)
            return
        with TakenVoxels(voxel_m) as taken:
            for index, points in enumerate(parts):
                kept = taken.first(points[:, :3].astype(np.float64))
                yield MapPiece(index, 0, np.eye(4), points[kept])

    def trajectory(self) -> Trajectory:
        """As MapSource."""
        return read_tum(self._folder / "trajectory.tum")

    def graph(self) -> MapGraph | None:
        """None: a run's folder has no graph."""
        return None


@contextmanager
def folder_source(folder: Path) -> Iterator[FolderSource]:
    """Raises InputError for a folder that is not a run's."""
    if missing := [name for name in ("map.ply", "trajectory.tum") if not (folder / name).is_file()]:
        raise InputError(f"{folder}: expected the folder of a run, found no {missing[0]} in it")
    yield FolderSource(folder)
