"""What is known of a map before one looks at it, or after its run: keyframes with their points, and a trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.tum import Trajectory
from splitslam.view.records import Array, Points
from splitslam.view.robot_scene import RobotScene

_SAME_M = 2e-3  # a keyframe is at the pose of one scan; both may have passed through nine decimals and a float32


@dataclass(frozen=True, slots=True, eq=False)
class ShownKeyframe:
    """T_map_lidar: (4, 4), corrected. points_lidar: (N, 3) float32, m, in its own frame."""

    index: int
    T_map_lidar: Array
    points_lidar: Points


def in_own_frame(points_map: NDArray, T_map_lidar: Array) -> Points:
    """(N, 3) from `map` into the keyframe's own frame."""
    T = se3.inv(T_map_lidar)
    return (np.asarray(points_map, np.float64) @ T[:3, :3].T + T[:3, 3]).astype(np.float32)


class KeyframeStamps:
    """When keyframes were taken: a keyframe is at the pose of one scan. They are asked for in order of time."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._trajectory, self._at = trajectory, 0

    def of(self, position_map: Array) -> int:
        """Stamp, ns, of the keyframe at (3,) m; one that fits no scan gets that of the keyframe before. 0: no scans."""
        positions_m, stamps_ns = self._trajectory.positions_m, self._trajectory.stamps_ns
        if not len(stamps_ns):
            return 0
        fitting = np.flatnonzero(np.linalg.norm(positions_m[self._at :] - position_map, axis=1) < _SAME_M)
        if len(fitting):
            self._at += int(fitting[0])
        return int(stamps_ns[self._at])


def show_way(robot: RobotScene, trajectory: Trajectory, taken_ns: Mapping[int, int]) -> None:
    """The corrected trajectory at once; each scan hangs on the last keyframe before it. taken_ns: stamp by keyframe."""
    order = sorted(taken_ns, key=lambda keyframe: taken_ns[keyframe])
    at = np.searchsorted([taken_ns[keyframe] for keyframe in order], trajectory.stamps_ns, side="right") - 1
    poses = zip(trajectory.positions_m, trajectory.quats_xyzw, strict=True)
    for stamp_ns, k, pose in zip(trajectory.stamps_ns.tolist(), at.tolist(), poses, strict=True):
        if k >= 0:
            robot.way(stamp_ns, order[k], se3.from_quat(*pose))
