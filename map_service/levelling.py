"""Keeps `map` level: compares it with the direction of gravity that the edge sends with each frame.

The edge knows "down" to about a milliradian once it has moved, not at a start in motion; the map is as level as the
first frame was, and its tilt drifts with the odometry. Levelling turns the map about its origin, which moves a robot
at 100 m by 10 cm for each milliradian: more than a map loses by standing a little askew. So nothing is done within
half a degree or the doubt of the direction itself, and what is done is done in small steps.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service.settings import LevelSettings

Array = NDArray[np.float64]
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Tilt:
    """How askew the map is at its newest keyframe: down_lidar (3,) unit vector that should be, size_rad, sigma_rad."""

    keyframe: int
    down_lidar: Array
    size_rad: float
    sigma_rad: float


class Leveller:
    """Collects gravity at keyframes; `tilt` speaks up when the map is too far from level, until it is level again."""

    def __init__(self, settings: LevelSettings) -> None:
        self.settings = settings
        self.active = False
        self._seen: deque[tuple[int, Array, float]] = deque(maxlen=settings.keyframes)

    def look(self, keyframe: int, gravity_lidar: Array, sigma_rad: float) -> None:
        """A keyframe with its direction of gravity (3,), frame `lidar`, and the doubt of it."""
        self._seen.append((keyframe, gravity_lidar / np.linalg.norm(gravity_lidar), sigma_rad))

    def tilt(self, poses: list[Array]) -> Tilt | None:
        """What to correct now, poses being T_map_lidar of all keyframes; None while the map is level enough."""
        s = self.settings
        if len(self._seen) < s.keyframes:
            return None
        down = np.median([poses[i][:3, :3] @ g for i, g, _ in self._seen], axis=0)
        down /= np.linalg.norm(down)
        size_rad = float(np.arccos(np.clip(down @ DOWN, -1.0, 1.0)))
        newest, _, sigma_rad = self._seen[-1]
        tolerable_rad = max(s.tolerable_rad, s.sigmas * sigma_rad)
        self.active = size_rad > (tolerable_rad * s.until_share if self.active else tolerable_rad)
        return Tilt(newest, poses[newest][:3, :3].T @ down, size_rad, sigma_rad) if self.active else None

    def factor_sigma_rad(self, tilt: Tilt, map_sigma_rad: float) -> float:
        """Standard deviation of a factor that turns the map by a small step, `map_sigma_rad` being its own doubt.

        Scalar Kalman gain: g = m^2 / (m^2 + sigma^2). Gravity's errors are those of the accelerometer's bias and last
        for minutes, so a factor is never stronger than one sigma of it.
        """
        gain = min(self.settings.step_rad / tilt.size_rad, 0.5)
        return max(tilt.sigma_rad, map_sigma_rad * float(np.sqrt(1.0 / gain - 1.0)))

    def dump(self) -> dict:
        """For a restart (JSON)."""
        return {"active": self.active, "seen": [[i, g.tolist(), sigma] for i, g, sigma in self._seen]}

    def load(self, data: dict) -> None:
        """The reverse of dump."""
        self.active = bool(data["active"])
        self._seen.extend((int(i), np.array(g), float(sigma)) for i, g, sigma in data["seen"])
