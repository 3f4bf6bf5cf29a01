"""How uncertain poses are: those of answers, and the odometry between keyframes that goes into the graph.

All covariances are (6, 6), right tangent, rotation first, rad and m.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from map_service.drift import MapDrift
from map_service.settings import DoubtSettings, GraphSettings, PipelineSettings
from map_service.tracker import Track
from map_service.tracker_state import TrackerState
from splitslam import se3

Array = NDArray[np.float64]


class Uncertainty:
    """drift: of the local map. found: has the robot been lost, and found again, since the last keyframe?"""

    def __init__(self, settings: PipelineSettings, drifts: list[Array]) -> None:
        """drifts: the graph's own list, of the map at each keyframe."""
        self.settings = settings
        self.drift = MapDrift(drifts)
        self.found = False
        self._map = np.eye(6) * 1e-8  # of the local map around the robot
        self._registered = np.zeros((6, 6))  # of the last scan that had features

    def follow(
        self,
        before: TrackerState | None,
        track: Track,
        motion_covariance: Array,
        T_local_keyframe: Callable[[int], Array],
    ) -> None:
        """The next scan, with the tracker's state before it; motion_covariance: (6, 6), of what was predicted."""
        r = track.registration
        if before is None or r is None or not r.features:
            return
        self.drift.follow(se3.inv(before.T_local_lidar) @ track.T_local_lidar, r.degenerate_axes, motion_covariance)
        self._map = self.drift.at(track.T_local_lidar, r.keyframes, T_local_keyframe)
        self._registered = r.covariance

    def pose(self, track: Track) -> Array:
        """(6, 6) of the pose in the frame of the first one: the map's where it was matched, and the registration's."""
        r = track.registration
        if r is None:
            return self._map
        covariance = r.covariance if r.features else self._registered + r.covariance
        return np.asarray(self._map + self.settings.doubt * covariance)

    def odometry(self, track: Track, motion: Array) -> Array:
        """(6, 6) of a registered keyframe's motion (4, 4) from the one that it follows."""
        s = self.settings.graph
        assert track.registration is not None
        translation = s.odometry_translation_m + s.odometry_translation_share * float(np.linalg.norm(motion[:3, 3]))
        floor = np.diag(np.repeat([s.odometry_rotation_rad**2, translation**2], 3))
        return track.registration.covariance + floor + self.drift.slip

    def since_lost(self, doubt: GraphSettings | DoubtSettings) -> Array:
        """What being lost adds to the covariance (6, 6) of the way since the last keyframe.

        The robot was found in the map, so the graph doubts the joint by decimetres; of its way there nothing is known.
        """
        return np.diag(np.repeat([doubt.kidnap_rad**2, doubt.kidnap_m**2], 3)) * self.found
