"""The local map: corners as lines and surfs as planes, in voxels of several sizes, filled as keyframes come.

Each voxel keeps the moments of the points in it and their fitted plane or line, so that a scan is matched by
look-up alone and a fit gets better with every keyframe that sees it. Sparse areas, where a small voxel holds too
few points for a fit, are covered by the coarser levels.
"""

from __future__ import annotations

import mmap

import numpy as np
from numpy.typing import NDArray

from splitslam.registration import _kernels as kernels
from splitslam.registration._equation_kernels import transform
from splitslam.registration.settings import LocalMapSettings, VoxelSettings

Array = NDArray[np.float64]
_CAPACITY = 1 << 14


class VoxelMap:
    """A hash map of voxels with one kind of fit (planes or lines), each made when a scan first asks for it.

    So a map that is filled with all its keyframes at once, after a restart or a loop, fits each voxel once, and those
    that no scan comes near never. moments, geometry: a row for each voxel, see _kernels.py.
    """

    def __init__(self, settings: VoxelSettings, kind: float, capacity: int = _CAPACITY) -> None:
        """capacity: of the hash table, a power of two; twice as many as there will be voxels, or it has to grow."""
        self.settings = s = settings
        limits = s.min_points, s.max_thickness_m, s.min_extent_share, s.max_thickness_ratio
        self.rules = np.array([s.voxel_m, s.levels, kind, *limits], np.float64)
        self._allocate(max(capacity, 8))

    def _allocate(self, capacity: int) -> None:
        self.slots = np.full((capacity, 2), -1, np.int64)
        self.moments = _on_demand(max(capacity // 2, 1), kernels.MOMENTS)
        self._geometry = _on_demand(max(capacity // 2, 1), kernels.GEOMETRY)
        self._pool = np.array([0, -1])
        self.used = 0

    def clear(self) -> None:
        """Forgets everything, keeps the memory."""
        self.slots.fill(-1)
        rows = int(self._pool[kernels.EVER_USED])
        self.moments[:rows], self._geometry[:rows] = 0.0, 0.0
        self._pool[:] = 0, -1
        self.used = 0

    @property
    def arrays(self) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """Slots, moments, geometry, rules, see _kernels.py: for kernels that match."""
        return self.slots, self.moments, self._geometry, self.rules

    @property
    def keys(self) -> NDArray[np.int64]:
        """(R,) of each row, see _kernels.py; -1 for those that are free."""
        keys, live = np.full(len(self.moments), -1), self.slots[:, 0] != -1
        keys[self.slots[live, 1]] = self.slots[live, 0]
        return keys

    @property
    def geometry(self) -> Array:
        """(R, 16) of each row, all fits made, see _kernels.py."""
        kernels.fit_all(self.slots, self.moments, self._geometry, self.rules)
        return self._geometry

    def insert(self, points: Array, keyframe: int) -> None:
        """Adds the points (N, 3), m, frame of the map, of a keyframe."""
        new = len(points) * self.settings.levels
        if 2 * (self.used + new) > len(self.slots):
            self._grow(new)
        self.used += kernels.insert(self.slots, self.moments, self._geometry, self._pool, self.rules, points, keyframe)

    def remove(self, points: Array) -> None:
        """Takes out the points (N, 3) of a keyframe that is in, the very same to the bit."""
        gone = np.empty(len(points) * self.settings.levels, np.int64)
        count = kernels.take_out(self.slots, self.moments, self._geometry, self.rules, points, gone)
        kernels.forget(self.slots, self.moments, self._geometry, self._pool, gone[:count])
        self.used -= count

    def _grow(self, new: int) -> None:
        """A larger table, with room for `new` more voxels; each keeps its row."""
        slots, moments, geometry, pool, used = self.slots, self.moments, self._geometry, self._pool, self.used
        capacity = len(slots)
        while capacity < 2 * (used + new):
            capacity *= 2
        self._allocate(capacity)
        kernels.rehash(self.slots, slots)
        rows = int(pool[kernels.EVER_USED])
        self.moments[:rows], self._geometry[:rows] = moments[:rows], geometry[:rows]
        self._pool, self.used = pool, used

    def match(self, points_lidar: Array, T_map_lidar: Array, gate_m: float, fits: Array) -> None:
        """fits (N, 16) out: the geometry (see _kernels.py) that points (N, 3) at T_map_lidar (4, 4) belong to."""
        kernels.match(self.slots, self.moments, self._geometry, self.rules, points_lidar, T_map_lidar, gate_m, fits)


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

    def become(self, other: LocalMap) -> None:
        """Takes over all that is in another map of the same settings, which is not to be used any more."""
        self.corners, self.surfs, self.keyframes = other.corners, other.surfs, other.keyframes

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


def _on_demand(rows: int, columns: int) -> Array:
    """(rows, columns) zeros that begin with a cache line; the system gives each page when it is first written to.

    numpy's own zeros come in pages of 2 MB where they are large, or from memory that the heap has to clear.
    """
    pages = mmap.mmap(-1, rows * columns * 8, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    return np.frombuffer(pages, np.float64).reshape(rows, columns)
