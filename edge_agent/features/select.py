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
from edge_agent.features.integer import FLAT, FeatureMarks
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
            corners = self._sharpest(corners, fewer_corners)
            surfs = _spread(surfs, fewer_surfs) if dense else _facing_all_ways(image, surfs, found, fewer_surfs)
        return _taken(image, corners), _taken(image, surfs)

    def _sharpest(self, corners: Index, target: int) -> Index:
        """The sharpest of every sector first, then the second of each, until there are enough."""
        chosen = np.empty(len(corners), np.bool_)
        choice.sharpest(self._rank[corners], target, chosen)
        return corners[chosen]


def _spread(index: Index, target: int) -> Index:
    chosen = np.empty(len(index), np.bool_)
    choice.spread(target, chosen)
    return index[chosen]


def _facing_all_ways(image: Image, surfs: Index, found: FeatureMarks, target: int) -> Index:
    """Flat and reliable ones, evenly by which way they face; rougher ones only when there are too few.

    Rusinkiewicz, Levoy, "Efficient variants of the ICP algorithm", 2001, section 3.1: normal-space sampling.
    """
    is_flat = found.marks[surfs] == FLAT
    flat = surfs[is_flat]
    group, chosen = np.empty(len(flat), np.uint8), np.empty(len(flat), np.bool_)
    choice.facing(image.points_lidar, image.column, image.ring_start, flat, group)
    taken = choice.spread_by_group(group, target, chosen)
    flat = flat[chosen]
    if taken >= target:
        return flat
    return np.sort(np.concatenate([flat, _spread(surfs[~is_flat], target - taken)]))


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
