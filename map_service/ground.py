"""Ground that is mapped already: there the robot moves from one old keyframe to the next and adds none.

So a map grows with the area that was seen, not with the time spent there. Every pose is told by a keyframe, its
`reference`: the newest one on new ground, the nearest old one on ground that is covered.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from map_service.keyframes import Keyframes
from map_service.loop_gate import Chain
from map_service.settings import GroundSettings
from splitslam import se3

Array = NDArray[np.float64]


class MappedGround:
    """Which keyframe stands for the robot's place."""

    def __init__(self, settings: GroundSettings) -> None:
        self.settings = settings
        self.reference = 0

    def covering(self, T_local_lidar: Array, stamp_ns: int, keyframes: Keyframes, chain: Chain) -> int | None:
        """The nearest keyframe that has seen what a scan at T_local_lidar (4, 4) sees; None: this is new ground.

        It is not of this visit, and the graph ties it to the reference by a short way: a place that the robot has come
        back to is no place of the map before a loop has said so, and until then the keyframes that find it are needed.
        """
        s = self.settings
        T = keyframes.poses_local()
        away_m = np.linalg.norm(T[:, :3, 3] - T_local_lidar[:3, 3], axis=1)
        old = keyframes.stamps_ns() <= stamp_ns - round(s.min_age_s * 1e9)
        near = np.flatnonzero(old & (away_m < s.reach_m))
        for i in near[np.argsort(away_m[near], kind="stable")].tolist():
            turned_rad = se3.angle(se3.inv(T[i]) @ T_local_lidar)
            if turned_rad < s.turn_rad and chain.tied_m(i, self.reference) < s.tied_m:
                return i
        return None
