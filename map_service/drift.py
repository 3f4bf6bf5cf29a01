"""How far off the local map may be where the robot is: what an answer's covariance holds besides the registration's.

A scan is placed relative to what it is matched with. That was put into the map by an earlier keyframe, whose own
error it has; so errors add up from new ground to new ground, not from scan to scan, and where the robot comes back to
old ground they are as small as they were then. Along directions that nothing observes, what the prediction may be
wrong by adds up from scan to scan, and all in one direction, as the error of a velocity does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from splitslam.registration.doubt import Slip, carried_over

Array = NDArray[np.float64]


class MapDrift:
    """keyframes: covariance (6, 6) of the map at each keyframe, right tangent of its pose, rotation first."""

    def __init__(self, keyframes: list[Array]) -> None:
        self.keyframes = keyframes
        self._slip = Slip()

    @property
    def slip(self) -> Array:
        """(6, 6), right tangent of the robot's pose, along what has not been observed since when."""
        return self._slip.covariance

    @slip.setter
    def slip(self, covariance: Array) -> None:
        self._slip.covariance = covariance

    def follow(self, T_prev_lidar: Array, unobserved: Array, motion_covariance: Array) -> None:
        """The next scan: its motion (4, 4) with the prediction's covariance (6, 6), and its unobserved axes (A, 6)."""
        self._slip.follow(T_prev_lidar, unobserved, motion_covariance)

    def at(self, T_local_lidar: Array, keyframes: NDArray[np.int64], T_local_keyframe: Callable[[int], Array]) -> Array:
        """(6, 6) of the map around T_local_lidar, for a scan matched with what `keyframes` (Q,) saw first."""
        if not len(keyframes):
            keyframes = np.array([len(self.keyframes) - 1])
        seen_by = [(T_local_keyframe(i), self.keyframes[i]) for i in keyframes.tolist()]
        return carried_over(T_local_lidar, seen_by) + self.slip
