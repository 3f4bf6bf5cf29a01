"""Keeps `map` level: compares it with the direction of gravity that the edge sends with each frame.

The edge knows "down" to about a milliradian once it has moved, not at a start in motion; the map is as level as the
first frame was, and its tilt drifts with the odometry. Levelling turns the map about its origin, which moves a robot
at 100 m by 10 cm for each milliradian: more than a map loses by standing a little askew. So once the map has
some size nothing is done within two degrees, or within the doubt of the direction itself, and the rest in small steps.

An IMU that is mounted a degree off shows "down" a degree off, the same way in the robot's frame wherever it heads. The
map's tilt is one in the map's frame, so the two are told apart as the robot turns, and only the map's is corrected.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from map_service.settings import LevelSettings
from splitslam.features import Motion

if TYPE_CHECKING:
    from map_service.graph import PoseGraph

Array = NDArray[np.float64]
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Tilt:
    """How askew the map is at its newest keyframe: down_lidar (3,) unit vector that should be, size_rad, sigma_rad.

    reach_m: how far the map goes from its origin, which it is turned about.
    """

    keyframe: int
    down_lidar: Array
    size_rad: float
    sigma_rad: float
    reach_m: float = 0.0


class Leveller:
    """Collects gravity at keyframes; `tilt` speaks up when the map is too far from level, until it is level again."""

    def __init__(self, settings: LevelSettings) -> None:
        self.settings = settings
        self.active = False
        self.reach_m = 0.0
        self._stood: tuple[Array, Array] | None = None  # gravity, and the rotation of the first keyframe
        self._seen: deque[tuple[int, Array, float]] = deque(maxlen=settings.window)

    def stood(self, gravity_lidar: Array, R_map_lidar: Array) -> None:
        """The robot stood at its first keyframe: what its accelerometer shows at rest is what the map calls level.

        An IMU that is askew has been so there too; what it says otherwise on the move is not the map's tilt.
        """
        self._stood = (gravity_lidar / np.linalg.norm(gravity_lidar), R_map_lidar)

    def begin(self, motion: Motion, R_map_lidar: Array) -> float:
        """The first keyframe, its rotation (3, 3) and what the edge says of it; the prior's sigma of its tilt, rad.

        A robot that stood there is level but for its IMU's mounting, which is not GNSS's to correct.
        """
        s, sigma_rad = self.settings, motion.gravity_sigma_rad
        if sigma_rad > s.stood_rad:
            return sigma_rad
        self.stood(motion.gravity_lidar, R_map_lidar)
        return min(sigma_rad, s.stood_prior_rad)

    def level(self, motion: Motion, keyframe: int, graph: PoseGraph) -> bool:
        """The newest keyframe: where the map is too far from level, a factor turns it by a step."""
        if motion.velocity_known:
            self.look(keyframe, motion.gravity_lidar, motion.gravity_sigma_rad)
        tilt = self.tilt(graph.poses)
        if tilt is None:
            return False
        sigma_rad = self.factor_sigma_rad(tilt, graph.tilt_sigma_rad(tilt.keyframe))
        graph.add_gravity(tilt.keyframe, tilt.down_lidar, sigma_rad)
        return True

    def look(self, keyframe: int, gravity_lidar: Array, sigma_rad: float) -> None:
        """A keyframe with its direction of gravity (3,), frame `lidar`, and the doubt of it."""
        self._seen.append((keyframe, gravity_lidar / np.linalg.norm(gravity_lidar), sigma_rad))

    def tilt(self, poses: Sequence[Array]) -> Tilt | None:
        """What to correct now, poses being T_map_lidar of all keyframes; None while the map is level enough."""
        s = self.settings
        if not self._seen:
            return None
        newest = self._seen[-1][0]
        self.reach_m = max(self.reach_m, float(np.linalg.norm(poses[newest][:3, 3])))
        if len(self._seen) < s.keyframes:
            return None
        x, covariance = self._solve(poses)
        size_rad = float(np.linalg.norm(x))
        sigma_rad = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
        down = DOWN + np.array([x[0], x[1], 0.0])
        down /= np.linalg.norm(down)
        free = size_rad * self.reach_m < s.step_m  # of a small map it costs nothing
        tolerable_rad = s.tolerable_rad if self._stood is None else s.stood_tolerable_rad
        tolerable_rad = max(s.near_rad if free else tolerable_rad, s.sigmas * sigma_rad)
        self.active = size_rad > (tolerable_rad * s.until_share if self.active else tolerable_rad)
        return Tilt(newest, poses[newest][:3, :3].T @ down, size_rad, sigma_rad, self.reach_m) if self.active else None

    def _solve(self, poses: Sequence[Array]) -> tuple[Array, Array]:
        """Tilt of the map (2,), the x and y of what should be down in it, with its covariance (2, 2).

        Least squares over the keyframes: R_i g_i = down + tilt + R_i mounting, older ones fading. Where the keyframes
        contradict each other by more than their sigmas, as with an IMU whose axes are askew, nothing is that sure: the
        covariance grows by the residuals' mean square.
        """
        s = self.settings
        prior = np.diag(np.concatenate([np.zeros(2), np.full(3, 1.0 / s.mounting_rad**2)]))
        R = np.stack([poses[i][:3, :3] for i, _, _ in self._seen])
        seen = np.einsum("nij,nj->ni", R, np.stack([gravity for _, gravity, _ in self._seen]))[:, :2]
        share = np.exp(-np.arange(len(R))[::-1] / s.fade)
        certainty = 1.0 / np.array([sigma for _, _, sigma in self._seen]) ** 2
        J = np.concatenate([np.broadcast_to(np.eye(2), (len(R), 2, 2)), R[:, :2]], axis=2)
        weight = share * certainty / s.alike
        normal = prior + np.einsum("n,nki,nkj->ij", weight, J, J)
        right = np.einsum("n,nki,nk->i", weight, J, seen)
        if self._stood is not None:
            gravity, R_first = self._stood
            J_first = np.hstack([np.eye(2), R_first[:2]])
            certainty_first = 1.0 / (s.stood_prior_rad**2 + (s.drift_rad_per_m * self.reach_m) ** 2)
            normal += certainty_first * J_first.T @ J_first
            right += certainty_first * J_first.T @ (R_first @ gravity)[:2]
        x = np.linalg.solve(normal, right)
        residuals = np.sum((seen - np.einsum("nki,i->nk", J, x)) ** 2, axis=1)
        mean_square = float(np.sum(share * certainty * residuals) / (2.0 * np.sum(share)))
        covariance = np.linalg.inv(normal) * max(mean_square, 1.0)
        return x[:2], np.asarray(covariance[:2, :2], np.float64)

    def factor_sigma_rad(self, tilt: Tilt, map_sigma_rad: float) -> float:
        """Standard deviation of a factor that turns the map by a small step, `map_sigma_rad` being its own doubt.

        Scalar Kalman gain: g = m^2 / (m^2 + sigma^2). Gravity's errors are those of the accelerometer's bias and last
        for minutes, so a factor is never stronger than one sigma of it.
        """
        s = self.settings
        step_m = s.young_step_m if tilt.reach_m < s.young_m else s.step_m
        step_rad = max(s.step_rad, step_m / max(tilt.reach_m, 1.0))
        gain = min(step_rad / tilt.size_rad, 0.9)
        return max(tilt.sigma_rad, map_sigma_rad * float(np.sqrt(1.0 / gain - 1.0)))

    def dump(self) -> dict:
        """For a restart (JSON)."""
        return {
            "active": self.active,
            "reach_m": self.reach_m,
            "stood": None if self._stood is None else [part.tolist() for part in self._stood],
            "seen": [[i, g.tolist(), sigma] for i, g, sigma in self._seen],
        }

    def load(self, data: dict) -> None:
        """The reverse of dump."""
        self.active, self.reach_m = bool(data["active"]), float(data["reach_m"])
        if data.get("stood") is not None:
            gravity, rotation = data["stood"]
            self._stood = (np.array(gravity), np.array(rotation))
        self._seen.extend((int(i), np.array(g), float(sigma)) for i, g, sigma in data["seen"])
