"""The truth of a drive as TUM lines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from splitslam.sim.trajectory import Trajectory


def tum(trajectory: Trajectory, start_ns: int, at_ns: NDArray[np.int64]) -> str:
    """T_world_lidar at times (N,) after the drive's start; stamps are `start_ns` later."""
    R, position = trajectory.poses(at_ns.astype(np.float64) * 1e-9)
    quaternion = Rotation.from_matrix(R).as_quat(canonical=True)
    stamps = (start_ns + at_ns).tolist()
    rows = np.concatenate([position, quaternion], axis=1).tolist()
    return "".join(
        f"{stamp // 10**9}.{stamp % 10**9:09d} {' '.join(f'{value:.9f}' for value in row)}\n"
        for stamp, row in zip(stamps, rows, strict=True)
    )
