"""Map points of a stored session for those who ask: corrected, in `map`, thinned when wanted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service.catalog import StoredKeyframe
from map_service.cloud import decode_cloud

_OFFSET = 1 << 20  # voxel indices of +-1,000,000 a side fit 21 bits each


@dataclass(frozen=True, slots=True, eq=False)
class MapPiece:
    """The points of one keyframe: (N, 4) little-endian float32, x y z m in `map` and intensity 0 to 255."""

    keyframe: int
    T_map_lidar: NDArray[np.float64]
    points_map: NDArray[np.float32]


def map_pieces(keyframes: Iterable[StoredKeyframe], voxel_m: float) -> Iterator[MapPiece]:
    """One piece a keyframe; with voxel_m > 0 each voxel of the whole map keeps its first point only.

    Raises DataError for a cloud that cannot be read.
    """
    taken: set[int] = set()
    for keyframe in keyframes:
        points_lidar, intensity, _ = decode_cloud(keyframe.cloud)
        T = keyframe.T_map_lidar
        points = points_lidar.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        if voxel_m > 0:
            kept = _first_in_voxel(points, voxel_m, taken)
            points, intensity = points[kept], intensity[kept]
        piece = np.column_stack([points, intensity]).astype("<f4")
        yield MapPiece(keyframe.index, T, piece)


def _first_in_voxel(points: NDArray[np.float64], voxel_m: float, taken: set[int]) -> NDArray[np.intp]:
    cells = np.floor(points / voxel_m).astype(np.int64) + _OFFSET
    keys, first = np.unique((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2], return_index=True)
    new = np.array([key not in taken for key in keys.tolist()], dtype=bool)
    taken.update(keys[new].tolist())
    return np.sort(first[new])
