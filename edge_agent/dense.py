"""The decision which frames are dense."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from edge_agent.settings import DenseSettings
from splitslam import se3


class DensePolicy:
    """Which frames carry all their features: the first ones, and where the robot has moved on since the last."""

    def __init__(self, settings: DenseSettings) -> None:
        self._settings = settings
        self._frames = 0
        self._T_dense_lidar = np.eye(4)
        self.wanted = False  # the map service asks for one (Advice)

    def decide(self, T_prev_lidar: NDArray[np.float64]) -> bool:
        """Takes the motion (4, 4) since the frame before; true when this one is to be dense."""
        s = self._settings
        self._T_dense_lidar = self._T_dense_lidar @ T_prev_lidar
        moved = math.hypot(*self._T_dense_lidar[:3, 3].tolist()) >= s.distance_m
        dense = self.wanted or self._frames < s.first_frames or moved or se3.angle(self._T_dense_lidar) >= s.angle_rad
        self._frames += 1
        if dense:
            self._T_dense_lidar = np.eye(4)
            self.wanted = False
        return bool(dense)
