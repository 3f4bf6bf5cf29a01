"""Maps made for the writers: points, times and places that are known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from splitslam import se3
from splitslam.maps import Georeference, MapGraph, MapPiece
from splitslam.tum import Trajectory

START_NS = 1_700_000_000_123_456_789  # 2023-11-14T22:13:20Z, 18 leap seconds
YOKOHAMA = Georeference(35.5, 139.6, 30.0, se3.exp(np.array([0.001, -0.002, 0.7, 12.0, -7.0, 1.5])))
CHILE = Georeference(-33.4, -70.6, 520.0, se3.exp(np.array([0.0, 0.0, -2.0, 300.0, 40.0, 0.0])))


def pieces(count: int = 5, points: int = 4000, seed: int = 3) -> list[MapPiece]:
    """Keyframes along a bend, walls and floor about them; every intensity occurs."""
    rng = np.random.default_rng(seed)
    made = []
    for k in range(count):
        T = se3.exp(np.array([0.0, 0.0, 0.2 * k, 3.0 * k, 0.4 * k * k, 0.0]))
        local = rng.uniform(-40.0, 40.0, (points, 3))
        local[::2, 2] = rng.normal(-1.0, 0.01, (points + 1) // 2)
        in_map = local @ T[:3, :3].T + T[:3, 3]
        made.append(MapPiece(k, START_NS + k * 700_000_000, T, np.column_stack(
            [in_map, rng.integers(0, 256, points)]).astype("<f4")))  # fmt: skip
    return made


def joined(of: list[MapPiece]) -> np.ndarray:
    """(N, 5) float64: x y z, intensity, keyframe."""
    rows = [np.column_stack([p.points_map.astype(np.float64), np.full(len(p.points_map), p.keyframe)]) for p in of]
    return np.concatenate(rows)


@dataclass(frozen=True)
class MadeSource:
    """A source of made pieces; fails after `fails_after` of them with `error`."""

    made: list[MapPiece]
    georeference: Georeference | None = None
    fails_after: int | None = None
    error: type[BaseException] = RuntimeError
    name: str = "robot/run"
    has_keyframes: bool = True

    @property
    def pieces_expected(self) -> int | None:
        return len(self.made)

    def pieces(self, voxel_m: float) -> Iterator[MapPiece]:
        for k, piece in enumerate(self.made):
            if k == self.fails_after:
                raise self.error
            yield piece

    def trajectory(self) -> Trajectory:
        T = np.array([piece.T_map_lidar for piece in self.made])
        quats = np.array([se3.quat_from_matrix(R) for R in T[:, :3, :3]])
        return Trajectory(np.array([piece.stamp_ns for piece in self.made]), T[:, :3, 3], quats)

    def graph(self) -> MapGraph | None:
        poses, stamps = np.array([p.T_map_lidar for p in self.made]), np.array([p.stamp_ns for p in self.made])
        if self.georeference is None:
            return MapGraph(poses, stamps, [])
        g = self.georeference
        return MapGraph(poses, stamps, [], [], {0: g.T_enu_map}, (g.latitude_deg, g.longitude_deg, g.altitude_m))
