"""What the pose of a scan may be off by, because of what it was matched with and of what nothing observed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.registration import _doubt_kernels as kernels

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
        if not len(unobserved):
            self.covariance = np.zeros((6, 6))
            return
        carry = se3.adjoint(se3.inv(T_prev_lidar))
        before = carry @ self.covariance @ carry.T
        self.covariance = np.zeros((6, 6))
        for axis in unobserved:
            sigma = np.sqrt(axis @ before @ axis) + np.sqrt(axis @ motion_covariance @ axis)
            self.covariance += sigma**2 * np.outer(axis, axis)


def carried_over(T_local_lidar: Array, seen_by: Sequence[tuple[Array, Array]]) -> Array:
    """(6, 6): mean error of the keyframes (pose (4, 4), covariance (6, 6) in its right tangent), seen at T_local_lidar.

    The map near the robot is off like a rigid body: each keyframe's error is carried over to the robot's pose.
    """
    mean = np.zeros((6, 6))
    if seen_by:
        poses, covariances = zip(*seen_by, strict=True)
        kernels.carried_over(T_local_lidar, np.array(poses), np.array(covariances), mean)
    return mean
