"""A LiDAR of any number of rings and columns, all rings of a column at once: for what depends on resolution or field.

A column's rays are cast from where the sensor is at that column's time. It spins, or, with a field less wide than a
turn, sweeps it once a scan, from left to right. It has a VLP-16's range noise and limits, and none of the faults of
`splitslam.sim.faults`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.scan import Scan
from splitslam.sim.beams import Beams
from splitslam.sim.seeds import stream
from splitslam.sim.spec import DriveSpec
from splitslam.sim.trajectory import Trajectory
from splitslam.sim.world import World

_FIELD_DEG = {16: (-15.0, 15.0), 32: (-25.0, 15.0)}  # VLP-16, VLP-32C
_OTHERS_DEG = (-22.5, 22.5)  # OS1


@dataclass(frozen=True, slots=True)
class Grid:
    """Rings and columns of one scan. field_deg: lowest and highest ring; None: as sensors of so many rings have it.
    width_deg: of the field that the columns share."""

    rings: int
    columns: int
    field_deg: tuple[float, float] | None = None
    width_deg: float = 360.0

    def __str__(self) -> str:
        return f"{self.rings}x{self.columns}"

    @property
    def elevations_deg(self) -> NDArray[np.float64]:
        """(rings,), from below."""
        return np.linspace(*(self.field_deg or _FIELD_DEG.get(self.rings, _OTHERS_DEG)), self.rings)

    @property
    def azimuths_rad(self) -> NDArray[np.float64]:
        """(columns,), clockwise seen from above: a turn begins ahead, a narrower field at its left."""
        left = 0.0 if self.width_deg == 360.0 else np.radians(self.width_deg) / 2
        return left - np.radians(self.width_deg) * np.arange(self.columns) / self.columns

    @property
    def columns_a_turn(self) -> int:
        """As many as a whole turn would have."""
        return round(self.columns * 360.0 / self.width_deg)


class GridLidar:
    """The sensor on its way through a world."""

    def __init__(self, grid: Grid, spec: DriveSpec, world: World, trajectory: Trajectory) -> None:
        self._grid, self._spec, self._trajectory = grid, spec, trajectory
        self._beams = Beams(spec, world, trajectory)
        self.scans = int(spec.duration_s * spec.lidar.rate_hz + 1e-9)

    def sweeps(self) -> Iterator[Scan]:
        """All turns in order; points (N, 3) float32 in frame `lidar`, each at its own time; firing by firing."""
        for k in range(self.scans):
            yield self._sweep(k)

    def _sweep(self, k: int) -> Scan:
        grid, lidar = self._grid, self._spec.lidar
        turn_ns = round(1e9 / lidar.rate_hz)
        column_ns = np.arange(grid.columns) * turn_ns // grid.columns
        azimuth = grid.azimuths_rad
        column, ring = (a.ravel() for a in np.meshgrid(np.arange(grid.columns), np.arange(grid.rings), indexing="ij"))
        e = np.radians(grid.elevations_deg)[ring]
        along = np.stack([np.cos(e) * np.cos(azimuth[column]), np.cos(e) * np.sin(azimuth[column]), np.sin(e)], axis=1)
        t_s = np.asarray((k * turn_ns + column_ns) * 1e-9, np.float64)
        R, position = self._trajectory.poses(t_s)
        directions = np.einsum("cij,crj->cri", R, along.reshape(grid.columns, grid.rings, 3)).reshape(-1, 3)
        hits = self._beams.cast(k, t_s[column], position[column], directions)
        noise_m = lidar.range_noise_m * stream(self._spec.seed, "range", k).normal(size=len(column))
        range_m = np.where(np.isfinite(hits.range_m), hits.range_m, 0.0) + noise_m
        seen = (hits.strength > lidar.detection) & (range_m >= lidar.min_range_m) & (range_m <= lidar.max_range_m)
        return Scan(
            stamp_ns=self._spec.start_ns + k * turn_ns,
            end_ns=self._spec.start_ns + k * turn_ns + int(column_ns[-1]),
            points_lidar=(along * range_m[:, None])[seen].astype(np.float32),
            t_offset_ns=column_ns[column][seen].astype(np.int32),
            ring=ring[seen].astype(np.uint8),
            intensity=np.clip(hits.reflectivity[seen], 1.0, 255.0).astype(np.uint8),
        )
