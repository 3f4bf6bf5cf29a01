"""Between features in `lidar` and whole steps in the beams that saw them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from splitslam.codec import _beam_kernels as kernels
from splitslam.codec import _merge_kernels as merge_kernels
from splitslam.codec._point_kernels import CLASS
from splitslam.codec.limits import DecodeError
from splitslam.features import FeatureFrame, FeatureSet, Knots
from splitslam.motion_table import motion_table

Table = tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]
Directions = tuple[NDArray[np.float64], NDArray[np.float64], float]
# Both sides move the points alike. What counts is that chords are not quite rigid: 0.1 mm at 217 deg/s and 100 m.
_SEGMENT_NS = 800_000


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Points in steps. counts (rings,) int64: points of each ring. points (7, N) int32, rows of _point_kernels."""

    counts: NDArray[np.int64]
    points: NDArray[np.int32]
    rate: int  # ns a column, 1/256; negative for a sensor that turns clockwise
    fractions: NDArray[np.float64]  # (N,) azimuth within the column, rad, 9 where the beam says nothing


def measure(frame: FeatureFrame, beam_elevations_rad: NDArray[np.float32], columns: int, step_um: int) -> Beams:
    """A frame's points in steps along and across their beams; ValueError for one that breaks FeatureSet's contract."""
    counts, points, points_lidar, t_offset_ns = merged(frame, len(beam_elevations_rad), columns)
    offsets_ns = frame.motion.knots.offsets_ns
    turn_ns = (offsets_ns[-1] - offsets_ns[0]) / columns
    rate = int(kernels.column_rate(counts, points, t_offset_ns, turn_ns))
    fractions = np.empty(len(t_offset_ns))
    if not kernels.follow_times(counts, rate, t_offset_ns, points, False):
        raise ValueError("a time beyond 2 s")
    directions = directions_of(columns, beam_elevations_rad, step_um)
    table = table_of(frame.motion.knots)
    if not kernels.to_steps(points_lidar, counts, t_offset_ns, table, directions, points, fractions):
        raise ValueError("a point is not finite or too far away")
    return Beams(counts, points, rate, fractions)


def merged(
    frame: FeatureFrame, rings: int, columns: int
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32], NDArray[np.int32]]:
    """Corners and surfs as one, by ring and column: counts (rings,), points (7, N), points_lidar (N, 3), t_offset_ns.

    Of points the rows CLASS, COLUMN and INTENSITY are filled. ValueError for features that break their contract.
    """
    n = len(frame.corners) + len(frame.surfs)
    counts, points = np.empty(rings, np.int64), np.zeros((7, n), np.int32)
    points_lidar, t_offset_ns = np.empty((n, 3), np.float32), np.empty(n, np.int32)
    both = _arrays(frame.corners), _arrays(frame.surfs)
    found = merge_kernels.merge(*both, columns, counts, points, points_lidar, t_offset_ns)
    if found == merge_kernels.UNSORTED:
        raise ValueError("features are not sorted by ring and column")
    if found == merge_kernels.OUTSIDE:
        raise ValueError(f"ring or column outside of {rings} x {columns}")
    return counts, points, points_lidar, t_offset_ns


def _arrays(features: FeatureSet) -> tuple[NDArray, ...]:
    return features.points_lidar, features.ring, features.column, features.t_offset_ns, features.intensity


def place(
    beams: Beams, knots: Knots, beam_elevations_rad: NDArray[np.float32], columns: int, step_um: int
) -> tuple[FeatureSet, FeatureSet]:
    """(corners, surfs) of decoded points: the inverse of measure. DecodeError for times beyond 2 s."""
    counts, points = beams.counts, beams.points
    n = points.shape[1]
    t_offset_ns, points_lidar = np.empty(n, np.int32), np.empty((n, 3), np.float32)
    if not kernels.follow_times(counts, beams.rate, t_offset_ns, points, True):
        raise DecodeError("corrupt", "a time beyond 2 s")
    directions = directions_of(columns, beam_elevations_rad, step_um)
    kernels.from_steps(points, counts, t_offset_ns, table_of(knots), directions, points_lidar)
    corner_count = int(np.count_nonzero(points[CLASS]))
    corners, surfs = _room(corner_count), _room(n - corner_count)
    merge_kernels.part(points, counts, points_lidar, t_offset_ns, _arrays(corners), _arrays(surfs))
    return corners, surfs


def _room(n: int) -> FeatureSet:
    return FeatureSet(
        points_lidar=np.empty((n, 3), np.float32),
        ring=np.empty(n, np.uint8),
        column=np.empty(n, np.uint16),
        t_offset_ns=np.empty(n, np.int32),
        intensity=np.empty(n, np.uint8),
    )


def table_of(knots: Knots, segment_ns: int = _SEGMENT_NS) -> Table:
    table = motion_table(knots, segment_ns)
    return table.breaks_ns, table.base, table.slope


def directions_of(columns: int, beam_elevations_rad: NDArray[np.float32], step_um: int) -> Directions:
    """What the kernels need to turn (ring, column) into a direction, and the step in metres."""
    return *_directions(columns, beam_elevations_rad.astype(np.float64).tobytes()), step_um * 1e-6


@lru_cache(maxsize=8)
def _directions(columns: int, elevations_rad: bytes) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(columns, 2) cos and sin of the columns' middles, (rings, 2) of the elevations (float64).

    LIO-SAM's image has +x in the middle, counter-clockwise.
    """
    azimuth = (np.arange(columns) - columns // 2) * (2.0 * np.pi / columns)
    elevation = np.frombuffer(elevations_rad, np.float64)
    return _units(azimuth.astype(np.float64)), _units(elevation)


def _units(angles_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
