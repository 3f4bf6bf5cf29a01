"""Settings of the local map and of the registration; both sides use the same."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from splitslam.config import Model


class VoxelSettings(Model):
    """Voxels of one feature class; level k has the size voxel_m * 2^k."""

    voxel_m: float = 0.5
    levels: int = 3
    min_points: int = 6
    max_thickness_m: float = 0.15
    min_extent_share: float = 0.1
    max_thickness_ratio: float = 0.35


class LocalMapSettings(Model):
    """The local map around the robot."""

    surfs: VoxelSettings = VoxelSettings()
    corners: VoxelSettings = VoxelSettings(voxel_m=0.5, levels=2, min_points=5, max_thickness_m=0.12)
    radius_m: float = 80.0
    rebuild_distance_m: float = Field(default=40.0, description="so much further behind keyframes stay in it")
    step_m: float = Field(default=5.0, description="way after which it is looked who is near")


class RegistrationSettings(Model):
    """Scan-to-map registration."""

    max_iterations: int = 20
    damping: float = 1e-6
    gate_start_m: float = 0.4
    gate_end_m: float = 0.3
    gate_sigmas: float = 2.0
    point_sigma_m: float = 0.02
    robust_sigmas: float = 1.5
    correlation: float = 8.0
    gate_limit_m: float = 3.0
    rotation_sigma_rad: float = 0.001
    position_sigma_m: float = 0.01
    converged_m: float = 2e-4
    converged_rad: float = 2e-5
    degenerate_information: float = 400.0
    degenerate_ratio: float = 10.0
    rematch_m: float = Field(default=0.002, description="points are matched again when the pose has moved by so much")
    lever_m: float = Field(default=5.0, description="rotation counts as this lever arm when axes are compared")

    @property
    def scale(self) -> np.ndarray:
        """(6,): metres of displacement for one unit of each tangent axis."""
        return np.array([self.lever_m] * 3 + [1.0] * 3)
