"""A stored session for those who ask: its poses, its map points and its graph, corrected, in `map`."""

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
from splitslam import dense_cloud
from splitslam.maps import MapPiece
from splitslam.ply import write_ply
from splitslam.se3 import quat_from_matrix
from splitslam.thinning import TakenVoxels
from splitslam.tum import Trajectory, write_tum


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written."""

    poses: int
    points: int


def write_session(catalog: Catalog, key: int, folder: Path, voxel_m: float) -> Exported:
    """trajectory.tum (T_map_lidar of every mapped frame) and map.ply in `folder`, which must exist.

    key: the session's in the store. voxel_m: as in map_pieces. Raises DataError for rows that cannot be read.
    """
    poses = trajectory(catalog, key)
    write_tum(folder / "trajectory.tum", poses)
    with closing(catalog.keyframes(key, dense=True)) as keyframes:  # else one that cannot be read leaves it open
        pieces = (piece.points_map.tobytes() for piece in map_pieces(keyframes, voxel_m))
        return Exported(len(poses), write_ply(folder / "map.ply", pieces))


def trajectory(catalog: Catalog, key: int) -> Trajectory:
    """T_map_lidar of every mapped frame of a session, in order of time. Raises DataError."""
    poses = [(stamp_ns, T) for page in catalog.trajectory(key) for _, stamp_ns, T in page]
    poses.sort(key=itemgetter(0))
    transforms = np.array([T for _, T in poses]).reshape(-1, 4, 4)
    quats = np.array([quat_from_matrix(T[:3, :3]) for T in transforms]).reshape(-1, 4)
    return Trajectory(np.array([stamp_ns for stamp_ns, _ in poses], np.int64), transforms[:, :3, 3], quats)


def map_pieces(keyframes: Iterable[StoredKeyframe], voxel_m: float) -> Iterator[MapPiece]:
    """One piece a keyframe; with voxel_m > 0 each voxel of the whole map keeps its first point only.

    A keyframe that comes with its whole scan is that. Raises DataError for a cloud that cannot be read.
    """
    if voxel_m == 0:
        for keyframe in keyframes:
            yield _piece(keyframe, *_in_map(keyframe))
        return
    with TakenVoxels(voxel_m) as taken:
        for keyframe in keyframes:
            points, intensity = _in_map(keyframe)
            kept = taken.first(points)
            yield _piece(keyframe, points[kept], intensity[kept])


def _in_map(keyframe: StoredKeyframe) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    if keyframe.dense is not None:
        points_lidar, intensity = dense_cloud.decode(keyframe.dense)
    else:
        points_lidar, intensity, _ = decode_cloud(keyframe.cloud)
    T = keyframe.T_map_lidar
    return points_lidar.astype(np.float64) @ T[:3, :3].T + T[:3, 3], intensity


def _piece(keyframe: StoredKeyframe, points_map: NDArray[np.float64], intensity: NDArray[np.uint8]) -> MapPiece:
    points = np.column_stack([points_map, intensity]).astype("<f4")
    return MapPiece(keyframe.index, keyframe.stamp_ns, keyframe.T_map_lidar, points, keyframe.dense is not None)
