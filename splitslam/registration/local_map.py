"""The local map: corners as lines and surfs as planes, in voxels of several sizes, filled as keyframes come.

Each voxel keeps the moments of the points in it and their fitted plane or line, so that a scan is matched by
look-up alone and a fit gets better with every keyframe that sees it. Sparse areas, where a small voxel holds too
few points for a fit, are covered by the coarser levels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.registration import _kernels as kernels
from splitslam.registration._equation_kernels import transform
from splitslam.registration.settings import LocalMapSettings, VoxelSettings

Array = NDArray[np.float64]
_CAPACITY = 1 << 14
_LINE_BYTES = 64


class VoxelMap:
    """A hash map of voxels with one kind of fit (planes or lines), each made when a scan first asks for it.

    So a map that is filled with all its keyframes at once, after a restart or a loop, fits each voxel once, and those
    that no scan comes near never.
    """

    def __init__(self, settings: VoxelSettings, kind: float, capacity: int = _CAPACITY) -> None:
        """capacity: voxels for which memory is taken at once, a power of two; twice as many as will be used."""
        self.settings = s = settings
        limits = s.min_points, s.max_thickness_m, s.min_extent_share, s.max_thickness_ratio
        self.rules = np.array([s.voxel_m, s.levels, kind, *limits], np.float64)
        self._allocate(capacity)

    def _allocate(self, capacity: int) -> None:
        self.keys = np.full(capacity, -1, np.int64)
        self.moments = np.zeros((capacity, kernels.MOMENTS))
        self._geometry = _in_cache_lines(capacity, kernels.GEOMETRY)
        self.used = 0

    def clear(self) -> None:
        """Forgets everything, keeps the memory."""
        self.keys.fill(-1)
        self.moments.fill(0.0)
        self._geometry.fill(0.0)
        self.used = 0

    @property
    def geometry(self) -> Array:
        """(capacity, 16) of each slot, all fits made, see _kernels.py."""
        kernels.fit_all(self.keys, self.moments, self._geometry, self.rules)
        return self._geometry

    def insert(self, points: Array, keyframe: int) -> None:
        """Adds the points (N, 3), m, frame of the map, of a keyframe."""
        new = len(points) * self.settings.levels
        if 2 * (self.used + new) > len(self.keys):
            self._grow(new)
        self.used += kernels.insert(self.keys, self.moments, self._geometry, self.rules, points, keyframe)

    def remove(self, points: Array) -> None:
        """Takes out the points (N, 3) of a keyframe that is in, the very same to the bit."""
        gone = np.empty(len(points) * self.settings.levels, np.int64)
        count = kernels.take_out(self.keys, self.moments, self._geometry, self.rules, points, gone)
        kernels.forget(self.keys, self.moments, self._geometry, gone[:count])
        self.used -= count

    def _grow(self, new: int) -> None:
        """A larger table, with room for `new` more voxels."""
        keys, moments, geometry = self.keys, self.moments, self._geometry
        live = np.flatnonzero(keys != -1)
        capacity = len(keys)
        while capacity < 2 * (len(live) + new):
            capacity *= 2
        self._allocate(capacity)
        slots = np.empty(len(live), np.int64)
        kernels.rehash(self.keys, keys[live], slots)
        self.moments[slots], self._geometry[slots] = moments[live], geometry[live]
        self.used = len(live)

    def match(self, points_lidar: Array, T_map_lidar: Array, gate_m: float, fits: Array) -> None:
        """fits (N, 16) out: the geometry (see _kernels.py) that points (N, 3) at T_map_lidar (4, 4) belong to."""
        kernels.match(self.keys, self.moments, self._geometry, self.rules, points_lidar, T_map_lidar, gate_m, fits)


class LocalMap:
    """Corner and surf maps in one frame, `local`; on the service, MapPipeline says how `local` relates to `map`."""

    def __init__(self, settings: LocalMapSettings, capacity: tuple[int, int] = (_CAPACITY, _CAPACITY)) -> None:
        """capacity: of the corner and the surf map at the start, see VoxelMap."""
        self.settings = settings
        self.corners = VoxelMap(settings.corners, kernels.LINE, capacity[0])
        self.surfs = VoxelMap(settings.surfs, kernels.PLANE, capacity[1])
        self.keyframes: set[int] = set()

    def clear(self) -> None:
        """Empties both maps."""
        self.corners.clear()
        self.surfs.clear()
        self.keyframes.clear()

    def insert(
        self,
        index: int,
        T_local_lidar: Array,
        corners_lidar: NDArray[np.float32],
        surfs_lidar: NDArray[np.float32],
    ) -> None:
        """Adds keyframe `index`: its points (N, 3) float32, frame `lidar`, at its pose (4, 4)."""
        self.corners.insert(_moved(T_local_lidar, corners_lidar), index)
        self.surfs.insert(_moved(T_local_lidar, surfs_lidar), index)
        self.keyframes.add(index)

    def remove(
        self,
        index: int,
        T_local_lidar: Array,
        corners_lidar: NDArray[np.float32],
        surfs_lidar: NDArray[np.float32],
    ) -> None:
        """Takes keyframe `index` out again; points and pose are those it was inserted with, to the bit."""
        self.corners.remove(_moved(T_local_lidar, corners_lidar))
        self.surfs.remove(_moved(T_local_lidar, surfs_lidar))
        self.keyframes.discard(index)


def _moved(T_local_lidar: Array, points_lidar: NDArray[np.float32]) -> Array:
    points_local = np.empty((len(points_lidar), 3))
    transform(T_local_lidar, points_lidar, points_local)
    return points_local


def _in_cache_lines(rows: int, columns: int) -> Array:
    """(rows, columns) zeros that begin with a cache line."""
    data = np.zeros(rows * columns + _LINE_BYTES // 8)
    first = -data.ctypes.data % _LINE_BYTES // 8
    return data[first : first + rows * columns].reshape(rows, columns)
