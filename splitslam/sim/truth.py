"""The truth of a drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from splitslam import tum
from splitslam.sim.trajectory import Trajectory


def truth(trajectory: Trajectory, start_ns: int, at_ns: NDArray[np.int64]) -> tum.Trajectory:
    """T_world_lidar at times (N,) after the drive's start; stamps are `start_ns` later."""
    R, position = trajectory.poses(at_ns.astype(np.float64) * 1e-9)
    return tum.Trajectory(start_ns + at_ns, position, Rotation.from_matrix(R).as_quat(canonical=True))
