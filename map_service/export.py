"""A stored session for those who ask: its poses and its map points, corrected, in `map`, thinned when wanted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from map_service.catalog import Catalog, StoredKeyframe
from map_service.cloud import decode_cloud
from splitslam.ply import write_ply
from splitslam.se3 import quat_from_matrix
from splitslam.tum import Trajectory, write_tum

MIN_VOXEL_M = 0.01
MAX_VOXEL_M = 100.0
_OFFSET = 1 << 20  # voxel indices of +-1,000,000 a side fit 21 bits each


@dataclass(frozen=True, slots=True, eq=False)
class MapPiece:
    """The points of one keyframe: (N, 4) little-endian float32, x y z m in `map` and intensity 0 to 255."""

    keyframe: int
    T_map_lidar: NDArray[np.float64]
    points_map: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written."""

    poses: int
    points: int


def voxel_problem(voxel_m: float) -> str | None:
    """Why a map cannot be thinned to voxels of this size, or None."""
    if voxel_m == 0 or MIN_VOXEL_M <= voxel_m <= MAX_VOXEL_M:  # false for NaN
        return None
    return f"{voxel_m:g}: expected 0 or {MIN_VOXEL_M:g} to {MAX_VOXEL_M:g}"


def write_session(catalog: Catalog, key: int, folder: Path, voxel_m: float) -> Exported:
    """trajectory.tum (T_map_lidar of every mapped frame) and map.ply in `folder`, which must exist.

    key: the session's in the store. voxel_m: as in map_pieces. Raises DataError for rows that cannot be read.
    """
    poses = [(stamp_ns, T) for page in catalog.trajectory(key) for _, stamp_ns, T in page]
    poses.sort(key=itemgetter(0))
    write_tum(folder / "trajectory.tum", _trajectory(poses))
    with closing(catalog.keyframes(key)) as keyframes:  # else a cloud that cannot be read leaves its connection open
        pieces = (piece.points_map.tobytes() for piece in map_pieces(keyframes, voxel_m))
        return Exported(len(poses), write_ply(folder / "map.ply", pieces))


def _trajectory(poses: list[tuple[int, NDArray[np.float64]]]) -> Trajectory:
    transforms = np.array([T for _, T in poses]).reshape(-1, 4, 4)
    quats = np.array([quat_from_matrix(T[:3, :3]) for T in transforms]).reshape(-1, 4)
    return Trajectory(np.array([stamp_ns for stamp_ns, _ in poses], np.int64), transforms[:, :3, 3], quats)


def map_pieces(keyframes: Iterable[StoredKeyframe], voxel_m: float) -> Iterator[MapPiece]:
    """One piece a keyframe; with voxel_m > 0 each voxel of the whole map keeps its first point only.

    Raises DataError for a cloud that cannot be read.
    """
    taken: set[int] = set()
    for keyframe in keyframes:
        points_lidar, intensity, _ = decode_cloud(keyframe.cloud)
        T = keyframe.T_map_lidar
        points = points_lidar.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        if voxel_m > 0:
            kept = first_in_voxel(points, voxel_m, taken)
            points, intensity = points[kept], intensity[kept]
        piece = np.column_stack([points, intensity]).astype("<f4")
        yield MapPiece(keyframe.index, T, piece)


def first_in_voxel(points: NDArray[np.float64], voxel_m: float, taken: set[int]) -> NDArray[np.intp]:
    """Which of the points (N, 3) m are the first in their voxel; `taken` remembers voxels between calls."""
    cells = np.floor(points / voxel_m).astype(np.int64) + _OFFSET
    keys, first = np.unique((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2], return_index=True)
    new = np.array([key not in taken for key in keys.tolist()], dtype=bool)
    taken.update(keys[new].tolist())
    return np.sort(first[new])
