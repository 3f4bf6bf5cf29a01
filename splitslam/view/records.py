"""What is shown of one scan, whoever knows it: a service that runs, or the folder of a finished run."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Points = NDArray[np.float32]
NO_POINTS: Points = np.zeros((0, 3), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Of one scan, (N, 3) float32, m, frame `lidar`.

    corner_matches_lidar, surf_matches_lidar: where the line or plane is that each was matched with; NaN without.
    """

    corners_lidar: Points = field(default_factory=lambda: NO_POINTS)
    surfs_lidar: Points = field(default_factory=lambda: NO_POINTS)
    corner_matches_lidar: Points = field(default_factory=lambda: NO_POINTS)
    surf_matches_lidar: Points = field(default_factory=lambda: NO_POINTS)

    @property
    def points_lidar(self) -> Points:
        """Both classes, (N, 3)."""
        return np.concatenate([self.corners_lidar, self.surfs_lidar])

    def correspondences_lidar(self, at_most: int) -> Points:
        """(M, 2, 3): from features to what they were matched with; evenly chosen where there are more."""
        features = self.points_lidar
        matches = np.concatenate([self.corner_matches_lidar, self.surf_matches_lidar])
        found = np.flatnonzero(np.isfinite(matches[:, 0]))
        if len(found) > at_most:
            found = found[np.linspace(0, len(found) - 1, at_most).astype(np.intp)]
        return np.stack([features[found], matches[found]], axis=1)


@dataclass(frozen=True, slots=True)
class Correction:
    """A jump of T_map_odom."""

    cause: str
    translation_m: float
    rotation_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class ScanShown:
    """T_map_lidar: (4, 4) as it was answered. keyframe: the one that it moves with when the map is corrected.

    covariance: (6, 6) of T_map_lidar, right tangent, rotation first, rad and m; None: not known. features: None: not
    known. frame_bytes and the times are NaN where they are not known.
    """

    stamp_ns: int
    T_map_lidar: Array
    state: str
    keyframe: int
    covariance: Array | None = None
    features: Features | None = None
    correction: Correction | None = None
    frame_bytes: float = float("nan")
    answer_ms: float = float("nan")
    registration_ms: float = float("nan")
    round_trip_ms: float = float("nan")
