"""What noisy fits seem to say of a direction that nothing observes."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam import se3
from splitslam.registration.local_map import LocalMap
from splitslam.registration.settings import LocalMapSettings
from tests.map_pipeline.test_registration import align

NONE = np.zeros((0, 3), np.float32)


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
