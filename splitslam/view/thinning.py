"""A map for the eye: each voxel keeps the first point that falls into it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_OFFSET = 1 << 20  # voxel indices of +-1,000,000 a side fit 21 bits each


class Thinner:
    """Of one robot's map. What it remembers grows with the mapped ground, not with time."""

    def __init__(self, voxel_m: float) -> None:
        """voxel_m: 0: every point stays."""
        self.voxel_m = voxel_m
        self._taken: set[int] = set()

    def kept(self, points_map: NDArray) -> NDArray[np.intp]:
        """Rows of points (N, 3), m, that are the first in their voxel, in order."""
        if self.voxel_m <= 0:
            return np.arange(len(points_map))
        cells = np.floor(np.asarray(points_map, np.float64) / self.voxel_m).astype(np.int64) + _OFFSET
        keys, first = np.unique((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2], return_index=True)
        new = np.array([key not in self._taken for key in keys.tolist()], bool)
        self._taken.update(keys[new].tolist())
        return np.sort(first[new])
