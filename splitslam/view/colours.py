"""Colours: a robot has one for its map, one for its way; what is measured looks the same for all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Rgb = tuple[int, int, int]

CORNER: Rgb = (255, 221, 64)
SURF: Rgb = (230, 240, 255)
MATCH: Rgb = (120, 255, 170)
COVARIANCE: Rgb = (255, 90, 200)
LOOP: Rgb = (255, 60, 60)
FIX: Rgb = (190, 120, 255)
BACKGROUND: Rgb = (13, 17, 23)


@dataclass(frozen=True, slots=True)
class RobotColours:
    """map_low, map_high: of the lowest and the highest points. way: the corrected trajectory; online: as answered."""

    map_low: Rgb
    map_high: Rgb
    way: Rgb
    online: Rgb

    def by_height(self, heights_m: NDArray, low_m: float, high_m: float) -> NDArray[np.uint8]:
        """(N, 3) colours of points (N,) between two heights."""
        share = np.clip((heights_m - low_m) / max(high_m - low_m, 1e-6), 0.0, 1.0)[:, None]
        return np.rint((1.0 - share) * np.array(self.map_low) + share * np.array(self.map_high)).astype(np.uint8)


_ROBOTS = (
    RobotColours((28, 64, 120), (120, 200, 255), (255, 140, 0), (150, 95, 35)),
    RobotColours((16, 84, 66), (120, 240, 190), (255, 70, 150), (150, 55, 95)),
    RobotColours((84, 60, 120), (205, 170, 255), (80, 230, 255), (45, 125, 140)),
    RobotColours((100, 72, 30), (250, 215, 140), (150, 255, 60), (85, 135, 40)),
)


def colours_of(number: int) -> RobotColours:
    """Of the n-th robot, from 0."""
    return _ROBOTS[number % len(_ROBOTS)]
