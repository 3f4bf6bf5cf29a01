"""Selection of corners and surfs (LOAM as LIO-SAM has it), and the thinning of frames that need not be dense.

Differences from LIO-SAM, all small: a ring's window never reaches into the ring before; picking flat points does not
suppress corners at the start of the next sector; and a voxel of surfs is represented by its real point nearest to the
centroid, so that every feature keeps its ring, column and time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge_agent.features import _kernels as kernels
from edge_agent.features.integer import FLAT, FeatureMarks
from edge_agent.features.projection import Image
from edge_agent.settings import FeatureSettings
from splitslam.features import FeatureSet


class Selector:
    """Selects features of one sensor's images, with buffers for rings x columns points."""

    def __init__(self, settings: FeatureSettings, rings: int, columns: int) -> None:
        self.settings = settings
        cells = rings * columns
        self._picked = np.empty(cells, np.uint8)
        self._rank = np.empty(cells, np.uint8 if settings.corners_per_sector < 256 else np.uint16)
        self._kept = np.empty(cells, np.uint8)
        self._chosen = np.empty(cells, np.uint8)
        self._group = np.empty(cells, np.uint8)
        self._voxel_of = np.empty(cells, np.int32)
        self._index = np.empty(cells, np.int32)
        self._wanted = (0, 0)
        slots = 1 << (2 * columns - 1).bit_length()
        self._table = np.empty((slots, 2), np.int64)
        self._sums = np.empty((columns, 6))

    def find(self, image: Image, found: FeatureMarks, dense: bool, times: float = 1.0) -> int:
        """Looks for the features of an image of deskewed points; how many a frame of that kind would carry.

        times: as many points as usual in a sparse one.
        """
        s, n = self.settings, len(image)
        picked, rank, kept = self._picked[:n], self._rank[:n], self._kept[:n]
        corners = kernels.select_corners(
            found.d, found.marks, image.column, picked, image.ring_start, s.sectors, s.corners_per_sector, rank
        )
        surfs = kernels.thin_surfs(
            image.points_lidar, rank, image.ring_start, s.surf_leaf_m, self._table, self._sums, self._voxel_of[:n], kept
        )
        self._wanted = (corners, surfs)
        if not dense:
            self._wanted = (min(corners, round(times * s.sparse_corners)), min(surfs, round(times * s.sparse_surfs)))
        return int(sum(self._wanted))

    def choose(
        self, image: Image, found: FeatureMarks, dense: bool, share: float = 1.0
    ) -> tuple[FeatureSet, FeatureSet]:
        """(corners, surfs) out of what `find` has found in this image, or an even share of them. All copies."""
        n = len(image)
        rank, kept, chosen = self._rank[:n], self._kept[:n], self._chosen[:n]
        corners, surfs = (round(share * wanted) for wanted in self._wanted)
        everything = dense and share >= 1.0
        if not everything:  # the sharpest of every sector first, then the second of each, until there are enough
            kernels.sharpest(rank, corners, chosen)
        taken_corners = self._take(image, rank if everything else chosen)
        if dense and not everything:
            kernels.spread(kept, surfs, chosen)
        elif not dense:
            self._facing_all_ways(image, kept, found, surfs, chosen)
        return taken_corners, self._take(image, kept if everything else chosen)

    def _facing_all_ways(
        self, image: Image, kept: NDArray[np.uint8], found: FeatureMarks, target: int, chosen: NDArray[np.uint8]
    ) -> None:
        """Flat and reliable ones, evenly by which way they face; rougher ones only when there are too few.

        Rusinkiewicz, Levoy, "Efficient variants of the ICP algorithm", 2001, section 3.1: normal-space sampling.
        """
        n = len(kept)
        flat, group = self._picked[:n], self._group[:n]
        kernels.pick(kept, found.marks, FLAT, True, flat)
        kernels.facing(image.points_lidar, image.column, image.ring_start, flat, group)
        taken = kernels.spread_by_group(flat, group, target, chosen)
        if taken < target:
            rough, more = group, flat  # neither is needed any more
            kernels.pick(kept, found.marks, FLAT, False, rough)
            kernels.spread(rough, target - taken, more)
            np.bitwise_or(chosen, more, out=chosen)

    def _take(self, image: Image, chosen: NDArray[np.unsignedinteger]) -> FeatureSet:
        """Copies of the points with chosen[i] not 0."""
        index = self._index[: kernels.indices(chosen, self._index)]
        return FeatureSet(
            points_lidar=image.points_lidar[index],
            ring=image.ring[index],
            column=image.column[index],
            t_offset_ns=image.t_offset_ns[index],
            intensity=image.intensity[index],
        )
