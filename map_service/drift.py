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

from splitslam import se3

Array = NDArray[np.float64]


class MapDrift:
    """keyframes: covariance (6, 6) of the map at each keyframe, right tangent of its pose, rotation first.

    slip: (6, 6), right tangent of the robot's pose, along what has not been observed since when.
    """

    def __init__(self, keyframes: list[Array]) -> None:
        self.keyframes = keyframes
        self.slip = np.zeros((6, 6))

    def follow(self, T_prev_lidar: Array, unobserved: Array, motion_covariance: Array) -> None:
        """The next scan: its motion (4, 4) with the prediction's covariance (6, 6), and its unobserved axes (A, 6)."""
        carry = se3.adjoint(se3.inv(T_prev_lidar))
        before = carry @ self.slip @ carry.T
        self.slip = np.zeros((6, 6))
        for axis in unobserved:
            sigma = np.sqrt(axis @ before @ axis) + np.sqrt(axis @ motion_covariance @ axis)
            self.slip += sigma**2 * np.outer(axis, axis)

    def at(self, T_local_lidar: Array, keyframes: NDArray[np.int64], T_local_keyframe: Callable[[int], Array]) -> Array:
        """(6, 6) of the map around T_local_lidar, for a scan matched with what `keyframes` (Q,) saw first.

        The map near the robot is off like a rigid body: each keyframe's error is carried over to the robot's pose.
        """
        if not len(keyframes):
            keyframes = np.array([len(self.keyframes) - 1])
        back = se3.inv(T_local_lidar)
        total = np.zeros((6, 6))
        for i in keyframes.tolist():
            carry = se3.adjoint(back @ T_local_keyframe(i))
            total += carry @ self.keyframes[i] @ carry.T
        return total / len(keyframes) + self.slip
