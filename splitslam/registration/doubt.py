"""What the pose of a scan may be off by, because of what it was matched with and of what nothing observed."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from splitslam import se3

Array = NDArray[np.float64]


class Slip:
    """Error along unobserved directions: what predictions may be wrong by adds up from scan to scan, and all in one
    direction, as the error of a velocity does.

    covariance: (6, 6), right tangent of the robot's pose, rotation first.
    """

    def __init__(self) -> None:
        self.covariance = np.zeros((6, 6))

    def follow(self, T_prev_lidar: Array, unobserved: Array, motion_covariance: Array) -> None:
        """The next scan: its motion (4, 4) with the prediction's covariance (6, 6), and its unobserved axes (A, 6)."""
        carry = se3.adjoint(se3.inv(T_prev_lidar))
        before = carry @ self.covariance @ carry.T
        self.covariance = np.zeros((6, 6))
        for axis in unobserved:
            sigma = np.sqrt(axis @ before @ axis) + np.sqrt(axis @ motion_covariance @ axis)
            self.covariance += sigma**2 * np.outer(axis, axis)


def carried_over(T_local_lidar: Array, seen_by: Iterable[tuple[Array, Array]]) -> Array:
    """(6, 6): mean error of the keyframes (pose (4, 4), covariance (6, 6) in its right tangent), seen at T_local_lidar.

    The map near the robot is off like a rigid body: each keyframe's error is carried over to the robot's pose.
    """
    back, total, count = se3.inv(T_local_lidar), np.zeros((6, 6)), 0
    for T_local_keyframe, covariance in seen_by:
        carry = se3.adjoint(back @ T_local_keyframe)
        total += carry @ covariance @ carry.T
        count += 1
    return total / max(count, 1)
