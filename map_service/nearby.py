"""The map around a place: points out of the stored keyframes, corrected, the nearest first, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, func, select

from map_service import schema
from map_service.cloud import decode_cloud
from map_service.packing import unpack_pose
from map_service.pose_at import NotKnownError
from map_service.session_scans import SessionScans
from map_service.store import Store
from splitslam.errors import DataError, InputError
from splitslam.maps import MapPiece
from splitslam.robot import robot_from_yaml
from splitslam.thinning import TakenVoxels

MIN_RADIUS_M, MAX_RADIUS_M = 0.1, 200.0
MAX_POINTS = 1_000_000
_AT_ONCE = 16

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Around:
    """Keyframes whose points may lie within the radius, nearest first: (index, T_map_lidar). centre_map: (3,) m."""

    centre_map: Array
    map_version: int
    keyframes: list[tuple[int, Array]]


@dataclass(frozen=True, slots=True, eq=False)
class NearbyPiece:
    """points_map: (N, 4) little-endian float32. truncated: it is the last one, and there was more."""

    piece: MapPiece
    map_version: int
    truncated: bool


def around(store: Store, key: int, centre_map: Array | None, radius_m: float) -> Around:
    """centre_map None: where the newest scan is. Raises NotKnownError without a scan, StoreError, DataError."""
    s, k = schema.sessions, schema.keyframes
    with store.reading() as connection:
        query = select(s.c.robot_file, func.coalesce(s.c.map_version, 1)).where(s.c.id == key)
        robot_file, map_version = connection.execute(query).one()
        query = select(k.c.keyframe, k.c.pose_map_lidar).where(k.c.session == key).order_by(k.c.keyframe)
        poses = {index: unpack_pose(pose) for index, pose in connection.execute(query)}
        centre = _newest(connection, key, poses) if centre_map is None else centre_map
    reach_m = radius_m + _range_m(robot_file)
    away_m = {index: float(np.linalg.norm(T[:3, 3] - centre)) for index, T in poses.items()}
    near = sorted((index for index in poses if away_m[index] <= reach_m), key=lambda index: away_m[index])
    return Around(centre, map_version, [(index, poses[index]) for index in near])


def _newest(connection: Connection, key: int, poses: dict[int, Array]) -> Array:
    scan = SessionScans(connection, key).newest_mapped()
    if scan is None:
        raise NotKnownError("the session has no scan")
    return (poses[scan.keyframe] @ scan.T_keyframe_lidar)[:3, 3]


def _range_m(robot_file: str) -> float:
    try:
        return robot_from_yaml(robot_file, "the stored robot file").lidar.max_range_m
    except InputError as error:
        raise DataError("corrupt", str(error)) from None


def nearby_pieces(
    store: Store, key: int, place: Around, radius_m: float, voxel_m: float, max_points: int
) -> Iterator[NearbyPiece]:
    """A piece for each keyframe that has points there; with voxel_m > 0 one point a voxel, of the nearest keyframe.

    No transaction stays open between pieces. Raises StoreError, also when the session was deleted meanwhile, DataError.
    """
    left = max_points
    with TakenVoxels(voxel_m or 1.0) as taken:
        for first in range(0, len(place.keyframes), _AT_ONCE):
            some = place.keyframes[first : first + _AT_ONCE]
            clouds = store.clouds(key, [index for index, _ in some])
            for index, T in some:
                points = _within(clouds[index], T, place.centre_map, radius_m)
                if voxel_m > 0:
                    points = points[taken.first(points[:, :3])]
                if not len(points):
                    continue
                full = len(points) > left
                piece = MapPiece(index, 0, T, points[:left].astype("<f4"))
                left -= len(piece.points_map)
                yield NearbyPiece(piece, place.map_version, full)
                if full:
                    return


def _within(cloud: bytes, T_map_lidar: Array, centre_map: Array, radius_m: float) -> Array:
    """(N, 4): x y z m in `map` and intensity of the points of a stored cloud that are near enough."""
    points_lidar, intensity, _ = decode_cloud(cloud)
    points = points_lidar.astype(np.float64) @ T_map_lidar[:3, :3].T + T_map_lidar[:3, 3]
    near = np.linalg.norm(points - centre_map, axis=1) <= radius_m
    return np.column_stack([points[near], intensity[near].astype(np.float64)])
