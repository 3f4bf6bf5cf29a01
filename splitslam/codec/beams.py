"""Between features in `lidar` and whole steps in the beams that saw them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from splitslam.codec import _beam_kernels as kernels
from splitslam.codec._point_kernels import CLASS, COLUMN, INTENSITY
from splitslam.codec.limits import DecodeError
from splitslam.features import FeatureFrame, FeatureSet, Knots
from splitslam.motion_table import motion_table

Table = tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]
_FASTEST = 4.0  # columns pass no faster than so many turns in a frame
_SHADES = 17  # of 256 to a step of the intensity


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Points in steps. counts (rings,) int64: points of each ring. points (7, N) int32, rows of _point_kernels."""

    counts: NDArray[np.int64]
    points: NDArray[np.int32]
    rate: int  # ns a column, 1/256; negative for a sensor that turns clockwise
    fractions: NDArray[np.float64]  # (N,) azimuth within the column, rad, 9 where the beam says nothing


def measure(frame: FeatureFrame, beam_elevations_rad: NDArray[np.float32], columns: int, step_um: int) -> Beams:
    """A frame's points in steps along and across their beams; ValueError for one that breaks FeatureSet's contract."""
    rings = len(beam_elevations_rad)
    order, (points_lidar, ring, column, t_offset_ns, intensity) = merged(frame)
    n = len(order)
    if n and (int(ring[-1]) >= rings or int(column.max()) >= columns):
        raise ValueError(f"ring or column outside of {rings} x {columns}")
    counts = np.bincount(ring, minlength=rings).astype(np.int64)
    points = np.zeros((7, n), np.int32)
    points[CLASS] = order < len(frame.corners)
    points[COLUMN] = column
    points[INTENSITY] = (intensity.astype(np.uint16) + 8) // _SHADES
    offsets_ns = frame.motion.knots.offsets_ns
    turn_ns = (offsets_ns[-1] - offsets_ns[0]) / columns
    rate, fractions = column_rate(counts, points, t_offset_ns, turn_ns), np.empty(n)
    if not kernels.follow_times(counts, rate, t_offset_ns, points, False):
        raise ValueError("a time beyond 2 s")
    directions = directions_of(columns, beam_elevations_rad, step_um)
    table = table_of(frame.motion.knots)
    if not kernels.to_steps(points_lidar, counts, t_offset_ns, table, directions, points, fractions):
        raise ValueError("a point is not finite or too far away")
    return Beams(counts, points, rate, fractions)


def merged(frame: FeatureFrame) -> tuple[NDArray[np.int32], tuple[NDArray, ...]]:
    """Corners and surfs as one, by ring and column: index of each, surfs after corners, and all five columns.

    ValueError where they are not sorted.
    """
    corners, surfs = frame.corners, frame.surfs
    order = np.empty(len(corners) + len(surfs), np.int32)
    if not kernels.merge(corners.ring, corners.column, surfs.ring, surfs.column, order):
        raise ValueError("features are not sorted by ring and column")
    names = ("points_lidar", "ring", "column", "t_offset_ns", "intensity")
    return order, tuple(np.concatenate([getattr(corners, name), getattr(surfs, name)])[order] for name in names)


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
    ring = np.repeat(np.arange(len(counts), dtype=np.uint8), counts)
    is_corner = points[CLASS] == 1

    def chosen(mask: NDArray[np.bool_]) -> FeatureSet:
        return FeatureSet(
            points_lidar=points_lidar[mask],
            ring=ring[mask],
            column=points[COLUMN][mask].astype(np.uint16),
            t_offset_ns=t_offset_ns[mask],
            intensity=points[INTENSITY][mask].astype(np.uint8) * np.uint8(_SHADES),
        )

    return chosen(is_corner), chosen(~is_corner)


def column_rate(
    counts: NDArray[np.int64], points: NDArray[np.int32], t_offset_ns: NDArray[np.int32], turn_ns: float
) -> int:
    """ns a column, 1/256. turn_ns: what it is if the frame is one turn, forwards or backwards.

    A few points, all of them beside the place where a scan begins and ends, would say something absurd: it is then the
    turn, in the direction in which more neighbours are.
    """
    rates = np.empty(points.shape[1])
    count = kernels.neighbour_rates(counts, points, t_offset_ns, rates)
    if count == 0:
        return 0
    rate = kernels.mean_rate(counts, points, t_offset_ns, float(np.median(rates[:count])))
    if abs(rate) > _FASTEST * turn_ns:
        rate = float(np.sign(np.sum(np.sign(rates[:count])))) * turn_ns
    return int(np.clip(round(rate * 256.0), -(2**31) + 1, 2**31 - 1))


def table_of(knots: Knots) -> Table:
    table = motion_table(knots)
    return table.breaks_ns, table.base, table.slope


def directions_of(
    columns: int, beam_elevations_rad: NDArray[np.float32], step_um: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """What the kernels need to turn (ring, column) into a direction, and the step in metres."""
    elevations = np.asarray(beam_elevations_rad, np.float64)
    return _azimuths(columns), np.stack([np.cos(elevations), np.sin(elevations)], axis=1), step_um * 1e-6


@lru_cache(maxsize=8)
def _azimuths(columns: int) -> NDArray[np.float64]:
    """(columns, 2) cos and sin of the columns' middles: LIO-SAM's image has +x in the middle, counter-clockwise."""
    azimuth = (np.arange(columns) - columns // 2) * (2.0 * np.pi / columns)
    return np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
