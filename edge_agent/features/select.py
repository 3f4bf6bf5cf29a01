"""Selection of corners and surfs (LOAM as LIO-SAM has it), and the thinning of frames that need not be dense.

Differences from LIO-SAM, all small: a ring's window never reaches into the ring before; picking flat points does not
suppress corners at the start of the next sector; and a voxel of surfs is represented by its real point nearest to the
centroid, so that every feature keeps its ring, column and time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge_agent.features import _choice_kernels as choice
from edge_agent.features import _kernels as kernels
from edge_agent.features._thinning_kernels import thin_surfs
from edge_agent.features.integer import FeatureMarks
from edge_agent.features.projection import Image
from edge_agent.settings import FeatureSettings
from splitslam.features import FeatureSet

Index = NDArray[np.int32]  # rows of an image, rising


class Selector:
    """Selects features of one sensor's images, with buffers for rings x columns points."""

    def __init__(self, settings: FeatureSettings, rings: int, columns: int) -> None:
        self.settings = settings
        cells = rings * columns
        self._picked = np.empty(cells, np.uint8)
        self._rank = np.empty(cells, np.uint8 if settings.corners_per_sector < 256 else np.uint16)
        self._corners, self._surfs = np.empty(cells, np.int32), np.empty(cells, np.int32)
        self._kept_corners, self._kept_surfs = np.empty(cells, np.int32), np.empty(cells, np.int32)
        self._found = self._wanted = (0, 0)
        slots = 1 << (2 * columns - 1).bit_length()
        self._table = np.empty((slots, 2), np.int64)
        self._sums = np.empty((columns, 6))

    def find(self, image: Image, found: FeatureMarks, dense: bool, times: float = 1.0) -> int:
        """Looks for the features of an image of deskewed points; how many a frame of that kind would carry.

        times: as many points as usual in a sparse one.
        """
        s, n = self.settings, len(image)
        picked, rank = self._picked[:n], self._rank[:n]
        kernels.select_corners(
            found.d, found.marks, image.column, picked, image.ring_start, s.sectors, s.corners_per_sector, rank
        )
        corners = kernels.indices(rank, self._corners)
        surfs = thin_surfs(
            image.points_lidar, rank, image.ring_start, s.surf_leaf_m, self._table, self._sums, self._surfs
        )
        self._found = self._wanted = (corners, surfs)
        if not dense:
            self._wanted = (min(corners, round(times * s.sparse_corners)), min(surfs, round(times * s.sparse_surfs)))
        return int(sum(self._wanted))

    def choose(
        self, image: Image, found: FeatureMarks, dense: bool, share: float = 1.0
    ) -> tuple[FeatureSet, FeatureSet]:
        """(corners, surfs) out of what `find` has found in this image, or an even share of them. All copies."""
        corners, surfs = self._corners[: self._found[0]], self._surfs[: self._found[1]]
        fewer_corners, fewer_surfs = (round(share * wanted) for wanted in self._wanted)
        if not dense or share < 1.0:
            few = self._kept_corners, self._kept_surfs
            corners = few[0][: choice.sharpest_of(self._rank, corners, fewer_corners, few[0])]
            if dense:
                surfs = few[1][: choice.spread_of(surfs, fewer_surfs, few[1])]
            else:
                seen = image.points_lidar, image.column, image.ring_start
                surfs = few[1][: choice.facing_all_ways(*seen, surfs, found.marks, fewer_surfs, few[1])]
        return _taken(image, corners), _taken(image, surfs)


def _taken(image: Image, index: Index) -> FeatureSet:
    """Copies of these points."""
    n, scan = len(index), image.scan
    taken = FeatureSet(
        points_lidar=np.empty((n, 3), np.float32),
        ring=np.empty(n, np.uint8),
        column=np.empty(n, np.uint16),
        t_offset_ns=np.empty(n, np.int32),
        intensity=np.empty(n, np.uint8),
    )
    seen = image.points_lidar, image.column, image.source, scan.ring, scan.t_offset_ns, scan.intensity
    choice.take(seen, index, (taken.points_lidar, taken.ring, taken.column, taken.t_offset_ns, taken.intensity))
    return taken
