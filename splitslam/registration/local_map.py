"""The local map: corners as lines and surfs as planes, in voxels of several sizes, filled as keyframes come.

Each voxel keeps the moments of the points in it and their fitted plane or line, so that a scan is matched by
look-up alone and a fit gets better with every keyframe that sees it. Sparse areas, where a small voxel holds too
few points for a fit, are covered by the coarser levels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.registration import _kernels as kernels
from splitslam.registration.settings import LocalMapSettings, VoxelSettings

_CAPACITY = 1 << 14


class VoxelMap:
    """A hash map of voxels with one kind of fit (planes or lines), made when it is first asked for.

    So a map that is filled with all its keyframes at once, after a restart or a loop, fits each voxel once.
    """

    def __init__(self, settings: VoxelSettings, kind: float, capacity: int = _CAPACITY) -> None:
        """capacity: voxels for which memory is taken at once, a power of two; twice as many as will be used."""
        self.settings = settings
        self.kind = kind
        self.limits = np.array(
            [settings.min_points, settings.max_thickness_m, settings.min_extent_share, settings.max_thickness_ratio]
        )
        self._allocate(capacity)

    def _allocate(self, capacity: int) -> None:
        self.keys = np.full(capacity, -1, np.int64)
        self.moments = np.zeros((capacity, 11))
        self._geometry = np.zeros((capacity, 13))
        self._stale: list[NDArray[np.int64]] = []  # slots whose fit is older than their moments
        self.used = 0

    def clear(self) -> None:
        """Forgets everything, keeps the memory."""
        self.keys.fill(-1)
        self.moments.fill(0.0)
        self._geometry.fill(0.0)
        self._stale.clear()
        self.used = 0

    @property
    def geometry(self) -> NDArray[np.float64]:
        """(capacity, 13) the fit of each slot, see kernels.fit."""
        if self._stale:
            s, touched = self.settings, np.unique(np.concatenate(self._stale))
            kernels.fit(self.keys, self.moments, self._geometry, touched, s.voxel_m, self.kind, self.limits)
            self._stale.clear()
        return self._geometry

    def insert(self, points: NDArray[np.float64], keyframe: int) -> None:
        """Adds the points (N, 3), m, frame of the map, of a keyframe."""
        new = len(points) * self.settings.levels
        if 2 * (self.used + new) > len(self.keys):
            self._grow(new)
        self.used += self._add(points, keyframe, 1.0)

    def remove(self, points: NDArray[np.float64]) -> None:
        """Takes out the points (N, 3) of a keyframe that is in, the very same to the bit."""
        self._add(points, 0, -1.0)
        touched = np.unique(self._stale[-1])
        gone = self.keys[touched[self.moments[touched, 0] == 0.0]]
        kernels.forget(self.keys, self.moments, self.geometry, gone)  # fitted before: slots move here
        self.used -= len(gone)

    def _add(self, points: NDArray[np.float64], keyframe: int, sign: float) -> int:
        """How many voxels are new."""
        s = self.settings
        touched = np.empty(len(points) * s.levels, np.int64)
        new = kernels.insert(self.keys, self.moments, points, keyframe, s.voxel_m, s.levels, sign, touched)
        self._stale.append(touched)
        return new

    def _grow(self, new: int) -> None:
        """A larger table, with room for `new` more voxels."""
        keys, moments, geometry, stale = self.keys, self.moments, self._geometry, self._stale
        live = np.flatnonzero(keys != -1)
        capacity = len(keys)
        while capacity < 2 * (len(live) + new):
            capacity *= 2
        self._allocate(capacity)
        slots = np.empty(len(live), np.int64)
        kernels.rehash(self.keys, keys[live], slots)
        self.moments[slots], self._geometry[slots] = moments[live], geometry[live]
        self.used = len(live)
        if stale:
            self._stale.append(slots)

    def match(self, points: NDArray[np.float64], gate_m: float, slots: NDArray[np.int64]) -> int:
        """Slots (N,) of the fits that points (N, 3) belong to, -1 for none; returns how many matched."""
        s = self.settings
        return kernels.match(self.keys, self.geometry, points, s.voxel_m, s.levels, gate_m, slots)


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
        T_local_lidar: NDArray[np.float64],
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
        T_local_lidar: NDArray[np.float64],
        corners_lidar: NDArray[np.float32],
        surfs_lidar: NDArray[np.float32],
    ) -> None:
        """Takes keyframe `index` out again; points and pose are those it was inserted with, to the bit."""
        self.corners.remove(_moved(T_local_lidar, corners_lidar))
        self.surfs.remove(_moved(T_local_lidar, surfs_lidar))
        self.keyframes.discard(index)


def _moved(T_local_lidar: NDArray[np.float64], points_lidar: NDArray[np.float32]) -> NDArray[np.float64]:
    points_local = np.empty((len(points_lidar), 3))
    kernels.transform(T_local_lidar, points_lidar, points_local)
    return points_local
