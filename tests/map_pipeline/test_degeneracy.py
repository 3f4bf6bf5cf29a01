"""What noisy fits seem to say of a direction that nothing observes."""

from __future__ import annotations

import numpy as np
import pytest

from map_service import _kernels as kernels
from map_service.local_map import LocalMap, VoxelMap
from map_service.settings import LocalMapSettings, VoxelSettings
from splitslam import se3
from tests.map_pipeline.naive import room, spurious_information
from tests.map_pipeline.test_registration import align

NONE = np.zeros((0, 3), np.float32)


@pytest.mark.parametrize("kind", [kernels.PLANE, kernels.LINE])
def test_spurious_information_is_what_wavering_axes_make(kind):
    rng = np.random.default_rng(3)
    surfs, corners = room(rng, 3000, 0.01)
    points = surfs if kind == kernels.PLANE else corners
    voxels = VoxelMap(VoxelSettings() if kind == kernels.PLANE else VoxelSettings(levels=2, min_points=5), kind)
    voxels.insert(points, 0)
    T = se3.exp(np.array([0.01, -0.02, 0.03, 0.05, -0.04, 0.02]))
    lidar = (points[::40] - T[:3, 3]) @ T[:3, :3]
    slots, noise = np.empty(len(lidar), np.int64), np.array([0.02, 1.5])
    voxels.match(lidar @ T[:3, :3].T + T[:3, 3], 0.5, slots)
    hit = slots >= 0
    assert hit.sum() > 15
    H = np.zeros((6, 6))
    kernels.spurious(voxels.geometry, voxels.moments, lidar, T, slots, noise, H)
    fits = []
    for g, n in zip(voxels.geometry[slots[hit]], voxels.moments[slots[hit], 0], strict=True):
        normal, longest = (g[3:6], g[10:13]) if kind == kernels.PLANE else (None, g[3:6])
        if normal is None:
            normal = np.linalg.svd(longest[None])[2][1]
        axes = np.column_stack([normal, np.cross(longest, normal), longest])
        fits.append((n, g[:3], axes, g[6:9], kind == kernels.PLANE))
    drawn = spurious_information(lidar[hit], T, fits, noise, 400, rng)
    np.testing.assert_allclose(np.diag(H), np.diag(drawn), rtol=0.15)


def tunnel(rng: np.random.Generator, count: int, from_m: float, to_m: float, sigma_m: float = 0.02) -> np.ndarray:
    """Points (count, 3) on the smooth wall of a round tunnel along x."""
    angle = rng.uniform(0, 2 * np.pi, count)
    surface = np.column_stack([rng.uniform(from_m, to_m, count), 2.5 * np.cos(angle), 2.5 * np.sin(angle)])
    return surface + rng.normal(0, sigma_m, surface.shape)


@pytest.mark.parametrize("map_points", [4_000, 40_000])
@pytest.mark.parametrize("scan_points", [1_000, 4_000])
def test_a_smooth_tunnel_is_unobserved_along_it_whatever_the_number_of_points(map_points, scan_points):
    rng = np.random.default_rng(5)
    local_map = LocalMap(LocalMapSettings())
    local_map.insert(0, np.eye(4), NONE, tunnel(rng, map_points, -30, 30).astype(np.float32))
    result = align(local_map, NONE, tunnel(rng, scan_points, -15, 15).astype(np.float32), np.eye(4))
    assert len(result.degenerate_axes) >= 1  # a round tunnel does not show roll either
    along = result.degenerate_axes[:, 3:] @ [1.0, 0.0, 0.0]
    assert np.abs(along).max() > 0.9


def test_a_wall_across_the_tunnel_makes_it_observed():
    rng = np.random.default_rng(6)
    end = np.column_stack([np.full(600, 12.0), rng.uniform(-2, 2, 600), rng.uniform(-2, 2, 600)])
    end += rng.normal(0, 0.02, end.shape)
    local_map = LocalMap(LocalMapSettings())
    local_map.insert(0, np.eye(4), NONE, np.concatenate([tunnel(rng, 20_000, -30, 12), end]).astype(np.float32))
    scan = np.concatenate([tunnel(rng, 1_000, -15, 12), end[::10]]).astype(np.float32)
    result = align(local_map, NONE, scan, se3.exp(np.array([0, 0, 0, 0.05, 0, 0])))
    assert not len(result.degenerate_axes) or np.abs(result.degenerate_axes[:, 3]).max() < 0.3
    assert abs(result.T_local_lidar[0, 3]) < 0.01
