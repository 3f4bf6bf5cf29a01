"""The feature frame: what the edge computes from a scan and the codec puts on the wire."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Knots:
    """Motion inside one scan: T_start_lidar(t), start = the scan's reference time.

    offsets_ns: (K,) int64 after the scan's stamp, strictly increasing, K >= 2, covering the scan.
    rotation: (K, 3) float64 rotation vector, rad. translation_m: (K, 3) float64.
    Between knots: rotation by slerp, translation linear; outside: held at the end knots' interval.
    """

    offsets_ns: NDArray[np.int64]
    rotation: NDArray[np.float64]
    translation_m: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What the Imu node knows about one scan. No absolute pose: it would be stale after a loop closure.

    T_prev_lidar: (4, 4), motion since frame seq - 1 (lidar at its stamp <- lidar at this stamp).
    covariance: (6, 6) of that motion, right tangent rx ry rz tx ty tz, rad and m.
    velocity_lidar_mps: (3,) at the scan's reference time, frame `lidar`.
    knots: the very knots the scan was deskewed with (already quantised).
    gravity_lidar: (3,) unit vector "down" at the reference time; gravity_sigma_rad its 1-sigma.
    velocity_known: False until odometry has come back (or the robot was seen standing).
    """

    T_prev_lidar: NDArray[np.float64]
    covariance: NDArray[np.float64]
    velocity_lidar_mps: NDArray[np.float64]
    knots: Knots
    gravity_lidar: NDArray[np.float64]
    gravity_sigma_rad: float
    velocity_known: bool


@dataclass(frozen=True, slots=True, eq=False)
class FeatureSet:
    """Features of one class (corner or surf), sorted by ring, then column.

    points_lidar: (N, 3) float32, deskewed to the reference time, m.
    ring: (N,) uint8; column: (N,) uint16; t_offset_ns: (N,) int32 after the reference time.
    intensity: (N,) uint8, coarse.
    """

    points_lidar: NDArray[np.float32]
    ring: NDArray[np.uint8]
    column: NDArray[np.uint16]
    t_offset_ns: NDArray[np.int32]
    intensity: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points_lidar)


@dataclass(frozen=True, slots=True, eq=False)
class FeatureFrame:
    """One scan on its way to the map service. seq starts at 1 and has no holes."""

    seq: int
    stamp_ns: int
    dense: bool
    motion: Motion
    corners: FeatureSet
    surfs: FeatureSet
