"""Stored scans as columns: what a commit wrote of each, whether it lies in a row of its own or in a block."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Row

from map_service import schema
from map_service.packing import unpack_all, unpack_factors
from splitslam.errors import DataError

Array = NDArray[np.float64]
NO_KEYFRAME = -1
_POSES = "pose_keyframe_lidar", "online_map_lidar", "online_map_odom"


@dataclass(frozen=True, slots=True, eq=False)
class StoredScan:
    """One scan as it was answered, poses (4, 4); of one that was `rejected`, for that reason, they mean nothing.

    covariance (6, 6); None: not kept by the release that answered. thinned: stamp and pose follow from other scans'.
    """

    seq: int
    stamp_ns: int
    state: int
    keyframe: int
    T_keyframe_lidar: Array
    T_map_lidar: Array
    T_map_odom: Array
    covariance: Array | None
    rejected: str
    thinned: bool


@dataclass(frozen=True, slots=True, eq=False)
class Scans:
    """n scans in order of seq. keyframe: NO_KEYFRAME of those that were rejected, whose poses mean nothing.

    Poses (n, 4, 4); T_map_lidar and T_map_odom as answered. factor (n, 6, 6): lower, of the covariance; NaN: none.
    """

    seq: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    state: NDArray[np.int64]
    keyframe: NDArray[np.int64]
    T_keyframe_lidar: Array
    T_map_lidar: Array
    T_map_odom: Array
    factor: Array
    rejected: NDArray[np.str_]
    thinned: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.seq)

    def __iter__(self) -> Iterator[StoredScan]:
        return map(self.scan, range(len(self)))

    @property
    def mapped(self) -> NDArray[np.bool_]:
        """(n,): which were not rejected."""
        return self.keyframe != NO_KEYFRAME

    def part(self, chosen: slice | NDArray) -> Scans:
        """Some of them."""
        return Scans(*(getattr(self, column.name)[chosen] for column in fields(self)))

    def scan(self, i: int) -> StoredScan:
        """The one in row i."""
        factor = self.factor[i]
        return StoredScan(
            int(self.seq[i]),
            int(self.stamp_ns[i]),
            int(self.state[i]),
            int(self.keyframe[i]),
            self.T_keyframe_lidar[i],
            self.T_map_lidar[i],
            self.T_map_odom[i],
            None if np.isnan(factor[0, 0]) else factor @ factor.T,
            str(self.rejected[i]),
            bool(self.thinned[i]),
        )


def joined(parts: Sequence[Scans]) -> Scans:
    """One after the other; at least one."""
    return Scans(*(np.concatenate([getattr(p, column.name) for p in parts]) for column in fields(Scans)))


def scans_of_rows(rows: Sequence[Row]) -> Scans:
    """Rows of `schema.frames`, in order. Raises DataError("corrupt") for what no commit wrote."""
    names = [column.name for column in schema.frames.columns]
    columns = dict(zip(names, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(names, ())
    n, rejected = len(rows), np.array(columns["rejected"], "U64")
    mapped = rejected == ""

    def there(name: str) -> list:
        return [value for value, lost in zip(columns[name], columns["rejected"], strict=True) if not lost]

    numbers = there("keyframe")
    if any(number is None or number < 0 for number in numbers):
        raise DataError("corrupt", "a frame on no keyframe")
    poses, factor = np.tile(np.eye(4), (3, n, 1, 1)), np.full((n, 6, 6), np.nan)
    packed = [data for name in _POSES for data in there(name)]
    poses[:, mapped] = unpack_all(packed).reshape(3, -1, 4, 4)
    factor[mapped] = unpack_factors(there("covariance"))
    keyframe = np.full(n, NO_KEYFRAME, np.int64)
    keyframe[mapped] = numbers
    return Scans(
        np.array(columns["seq"], np.int64),
        np.array(columns["stamp_ns"], np.int64),
        np.array(columns["state"], np.int64),
        keyframe,
        poses[0],
        poses[1],
        poses[2],
        factor,
        rejected,
        np.zeros(n, bool),
    )
