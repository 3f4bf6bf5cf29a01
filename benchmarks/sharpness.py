"""How thick planes are in the map that a trajectory makes of the raw scans: a check that needs no exact truth.

Trajectories are compared on the same points: each scan is deskewed by the same motion (the truth's, within the scan, to
the moment that the system's pose is of), then placed by the system's pose, and the maps are moved onto the truth so
that their cells are at the same places. A cell is a cube of 0.5 m. It counts when it has at least 30 points of at
least 5 scans in every map and is a plane in at least one: its points spread over more than 10 cm in two directions and
less than a third of that in the third. Its thickness is the square root of the smallest eigenvalue of its points'
covariance (RMS distance from the best plane); the sharpness is the mean over the cells. Which cells count is the same
for all maps: otherwise a blurred map would lose its worst cells and look sharp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.alignment import interpolate, umeyama
from splitslam.evaluate import inside
from splitslam.tum import Trajectory

Array = NDArray[np.float64]
CELL_M = 0.5
MIN_POINTS, MIN_SCANS = 30, 5
MIN_SPREAD_M, MAX_FLATNESS = 0.10, 1.0 / 3.0
MAX_RANGE_M = 60.0
_BITS = 20  # of a cell's number on each axis: half a million metres


@dataclass(frozen=True, slots=True, eq=False)
class MadeMap:
    """Points (N, 3), m, in the truth's frame, and the scan (N,) int64 that each is of."""

    points_m: Array
    scan: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Sharpness:
    """Mean thickness of the planes, m, of each map, over the same `cells` cells."""

    cells: int
    thickness_m: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    keys: NDArray[np.int64]
    points: NDArray[np.int64]
    scans: NDArray[np.int64]
    spread_m: Array  # (K, 3) standard deviations, ascending


def place(
    scans: list[tuple[int, Array, NDArray[np.int64]]], system: Trajectory, truth: Trajectory, offset_ns: int
) -> MadeMap:
    """The map of `scans` (stamp_ns, points (N, 3) at their own times, times after the stamp (N,) ns) by `system`.

    system: poses with the scans' stamps; they are of `offset_ns` later. truth: dense (benchmarks/scoring.py). Scans
    that the truth does not cover, or without a pose, are left out.
    """
    poses = dict(zip(system.stamps_ns.tolist(), range(len(system)), strict=True))
    at = Trajectory(system.stamps_ns + offset_ns, system.positions_m, system.quats_xyzw)
    scored = at[inside(at, truth)]
    T_truth_system = umeyama(scored.positions_m, interpolate(truth, scored.stamps_ns).positions_m)
    placed, numbers = [], []
    for number, (stamp_ns, points, times_ns) in enumerate(scans):
        row = poses.get(stamp_ns)
        times_ns = stamp_ns + times_ns
        first_ns, last_ns = min(times_ns.min(), stamp_ns + offset_ns), max(times_ns.max(), stamp_ns + offset_ns)
        if row is None or first_ns < truth.stamps_ns[0] or last_ns > truth.stamps_ns[-1]:
            continue
        near = np.linalg.norm(points, axis=1) < MAX_RANGE_M
        still = _to_moment(points[near], interpolate(truth, times_ns[near]), truth, stamp_ns + offset_ns)
        moved = _turn(system.quats_xyzw[row][None], still) + system.positions_m[row]
        placed.append(moved @ T_truth_system[:3, :3].T + T_truth_system[:3, 3])
        numbers.append(np.full(len(moved), number))
    return MadeMap(np.concatenate(placed), np.concatenate(numbers))


def compare(maps: list[MadeMap]) -> Sharpness | None:
    """Thickness of the planes in each of `maps`, over the cells that count in all of them; None without any."""
    cells = [_cells(one) for one in maps]
    keys = cells[0].keys
    for other in cells[1:]:
        keys = np.intersect1d(keys, other.keys, assume_unique=True)
    rows = [np.searchsorted(one.keys, keys) for one in cells]
    enough = np.ones(len(keys), bool)
    plane = np.zeros(len(keys), bool)
    for one, row in zip(cells, rows, strict=True):
        enough &= (one.points[row] >= MIN_POINTS) & (one.scans[row] >= MIN_SCANS)
        spread = one.spread_m[row]
        plane |= (spread[:, 1] > MIN_SPREAD_M) & (spread[:, 0] < MAX_FLATNESS * spread[:, 1])
    counts = enough & plane
    if not counts.any():
        return None
    thickness = (float(one.spread_m[row][counts, 0].mean()) for one, row in zip(cells, rows, strict=True))
    return Sharpness(int(np.count_nonzero(counts)), tuple(thickness))


def _cells(one: MadeMap) -> _Cells:
    """Every occupied cell, ascending by key."""
    index = np.floor(one.points_m / CELL_M).astype(np.int64) + (1 << (_BITS - 1))
    key = (index[:, 0] << (2 * _BITS)) | (index[:, 1] << _BITS) | index[:, 2]
    order = np.lexsort((one.scan, key))
    key, points, scan = key[order], one.points_m[order], one.scan[order]
    new = np.append(True, key[1:] != key[:-1])
    starts = np.flatnonzero(new)
    counts = np.diff(np.append(starts, len(key)))
    scans = np.add.reduceat((new | np.append(True, scan[1:] != scan[:-1])).astype(np.int64), starts)
    mean = np.add.reduceat(points, starts) / counts[:, None]
    centred = points - np.repeat(mean, counts, axis=0)
    second = np.add.reduceat(centred[:, :, None] * centred[:, None, :], starts) / counts[:, None, None]
    return _Cells(key[starts], counts, scans, np.sqrt(np.maximum(np.linalg.eigvalsh(second), 0.0)))


def _to_moment(points: Array, at_points: Trajectory, truth: Trajectory, moment_ns: int) -> Array:
    """Points at their own times, the sensor's poses at those times -> the sensor's frame at `moment_ns`."""
    world = _turn(at_points.quats_xyzw, points) + at_points.positions_m
    moment = interpolate(truth, np.array([moment_ns], np.int64))
    back = moment.quats_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])
    return _turn(back, world - moment.positions_m)


def _turn(quats_xyzw: Array, vectors: Array) -> Array:
    """R(q) v for each row: v + 2 u x (u x v + w v)."""
    u, w = quats_xyzw[:, :3], quats_xyzw[:, 3:]
    return vectors + 2.0 * np.cross(u, np.cross(u, vectors) + w * vectors)
