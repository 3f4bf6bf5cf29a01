"""What there is to see of a session's map and of the scan that was answered last, for those who watch (views.py)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service.graph import PoseGraph
from map_service.tracker import Track, Tracker
from splitslam import se3
from splitslam.registration._kernels import GEOMETRY, KIND
from splitslam.registration.local_map import VoxelMap

Array = NDArray[np.float64]
Points = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class ScanSeen:
    """A scan's features as they were registered, and what they were matched with.

    corners_lidar, surfs_lidar: (N, 3) float32, m, frame `lidar`. corner_matches_lidar, surf_matches_lidar: the same
    shapes, where the matched line or plane is (the mean of its points); NaN for a feature without.
    keyframe: that the scan becomes, or that it moves with when the map is corrected.
    """

    keyframe: int
    registration_ms: float
    corners_lidar: Points
    surfs_lidar: Points
    corner_matches_lidar: Points
    surf_matches_lidar: Points


@dataclass(frozen=True, slots=True, eq=False)
class MapSeen:
    """The graph as it stands.

    T_map_keyframes: (n, 4, 4), a view. loops: (older, newer) keyframes. fix_keyframes: (m,) int64, and fixes_map:
    (m, 3), the antenna positions that GNSS factors ask for, m, frame `map`.
    """

    T_map_keyframes: Array
    loops: list[tuple[int, int]]
    fix_keyframes: NDArray[np.int64]
    fixes_map: Array


def scan_seen(tracker: Tracker, track: Track, keyframe: int, registration_ms: float) -> ScanSeen:
    """Of the scan tracked last, as long as the local map is the one that it was registered against."""
    local_map, gate_m = tracker.local_map, tracker.settings.registration.gate_end_m
    T = track.T_local_lidar
    corners, surfs = (np.ascontiguousarray(points, np.float32) for points in (track.corners_lidar, track.surfs_lidar))
    return ScanSeen(
        keyframe,
        registration_ms,
        corners,
        surfs,
        _matches(local_map.corners, corners, T, gate_m),
        _matches(local_map.surfs, surfs, T, gate_m),
    )


def _matches(voxels: VoxelMap, points_lidar: Points, T_local_lidar: Array, gate_m: float) -> Points:
    """(N, 3) float32, frame `lidar`: the same look-up as the registration's last one, at the pose that it found."""
    fits = np.empty((len(points_lidar), GEOMETRY))
    voxels.match(points_lidar.astype(np.float64), T_local_lidar, gate_m, fits)
    T_lidar_local = se3.inv(T_local_lidar)
    matches, found = np.full((len(fits), 3), np.nan, np.float32), fits[:, KIND] != 0.0  # the other rows are not written
    matches[found] = fits[found, :3] @ T_lidar_local[:3, :3].T + T_lidar_local[:3, 3]
    return matches


def map_seen(graph: PoseGraph, newest_fixes: int) -> MapSeen:
    """With the newest so many GNSS factors."""
    keyframes, data, enu_m = graph.fixes(newest_fixes)
    fixes_map = np.empty((len(enu_m), 3))
    for datum, T_enu_map in graph.data.items():
        T, of = se3.inv(T_enu_map), data == datum
        fixes_map[of] = enu_m[of] @ T[:3, :3].T + T[:3, 3]
    return MapSeen(graph.poses.matrices, graph.loops, keyframes, fixes_map)
