from __future__ import annotations

import numpy as np
import pytest

from splitslam import se3
from splitslam.registration import _equation_kernels as equations
from splitslam.registration import _kernels as kernels
from splitslam.registration.local_map import VoxelMap
from splitslam.registration.settings import VoxelSettings
from tests.map_pipeline.naive import room, spurious_information


@pytest.mark.parametrize("kind", [kernels.PLANE, kernels.LINE])
def test_spurious_information_is_what_wavering_axes_make(kind):
    rng = np.random.default_rng(3)
    surfs, corners = room(rng, 3000, 0.01)
    points = surfs if kind == kernels.PLANE else corners
    voxels = VoxelMap(VoxelSettings() if kind == kernels.PLANE else VoxelSettings(levels=2, min_points=5), kind)
    voxels.insert(points, 0)
    T = se3.exp(np.array([0.01, -0.02, 0.03, 0.05, -0.04, 0.02]))
    lidar = (points[::40] - T[:3, 3]) @ T[:3, :3]
    matched, noise = np.empty((len(lidar), kernels.GEOMETRY)), np.array([0.02, 1.5, 0.5])
    voxels.match(lidar, T, 0.5, matched)
    hit = matched[:, kernels.KIND] != 0.0
    assert hit.sum() > 15
    H = np.zeros((6, 6))
    equations.spurious(matched, lidar, T, noise, H)
    fits = []
    for g in matched[hit]:
        longest = g[kernels.LONGEST : kernels.LONGEST + 3]
        normal, longest = (g[3:6], longest) if kind == kernels.PLANE else (None, g[3:6])
        if normal is None:
            normal = np.linalg.svd(longest[None])[2][1]
        axes = np.column_stack([normal, np.cross(longest, normal), longest])
        fits.append((g[kernels.COUNT], g[:3], axes, g[kernels.L_MIN : kernels.L_MAX + 1], kind == kernels.PLANE))
    drawn = spurious_information(lidar[hit], T, fits, noise, 400, rng)
    np.testing.assert_allclose(np.diag(H), np.diag(drawn), rtol=0.15)
