from __future__ import annotations

import math

import numpy as np
import pytest

from map_service import _place_kernels as kernels
from map_service.places import PlaceIndex
from map_service.settings import PlaceSettings
from splitslam import se3


def surroundings(seed: int, count: int = 3000) -> np.ndarray:
    """Walls and posts of several heights around the origin, (N, 3)."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(25):
        a, b = rng.uniform(-35, 35, (2, 2))
        along = rng.uniform(0, 1, (count // 25, 1))
        height = rng.uniform(0.5, 8.0)
        parts.append(np.hstack([a + along * (b - a) * min(1.0, 8.0 / np.linalg.norm(b - a)),
                                rng.uniform(-1.2, height, (count // 25, 1))]))  # fmt: skip
    return np.concatenate(parts).astype(np.float32)


def turned(points: np.ndarray, yaw: float, shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """The same place from `shift` beside it, looking `yaw` further to the left."""
    moved = points - np.array([*shift, 0.0])
    return (moved @ se3.so3_exp(np.array([0, 0, yaw]))).astype(np.float32)


def naive_heights(points, centre, ring_m, floor_m, ceiling_m, rings, sectors):
    heights = np.zeros((rings, sectors))
    for x, y, z in points.astype(float):
        ring = int(math.hypot(x - centre[0], y - centre[1]) // ring_m)
        sector = int((math.atan2(y - centre[1], x - centre[0]) + math.pi) / (2 * math.pi) * sectors) % sectors
        if ring < rings:
            heights[ring, sector] = max(heights[ring, sector], min(max(z - floor_m, 0.0), ceiling_m))
    return heights


def test_the_descriptor_is_the_highest_point_of_each_cell():
    points, centre = surroundings(1, 500), np.array([1.5, -0.5])
    heights = np.full((20, 60), 7.0)
    kernels.polar_heights(points, centre, 2.0, -2.0, 8.0, heights)
    np.testing.assert_allclose(heights, naive_heights(points, centre, 2.0, -2.0, 8.0, 20, 60), atol=1e-5)
    assert (heights > 0).sum() > 20


@pytest.mark.parametrize("yaw_deg", [0.0, 47.0, 180.0, -100.0])
def test_a_place_is_found_again_whatever_the_heading(yaw_deg: float):
    index = PlaceIndex(PlaceSettings())
    for seed in range(100):
        index.add(surroundings(seed))
    yaw = np.radians(yaw_deg)
    match = index.search(turned(surroundings(63), yaw), 100)
    assert match is not None
    assert match.older == 63
    assert match.likeness > 0.8
    off = se3.so3_log(match.T_older_newer[:3, :3] @ se3.so3_exp(np.array([0, 0, -yaw])))
    assert np.linalg.norm(off) < np.radians(6.0)


def test_a_place_is_found_again_from_the_next_lane_with_about_the_right_offset():
    index = PlaceIndex(PlaceSettings())
    for seed in range(100):
        index.add(surroundings(seed))
    match = index.search(turned(surroundings(41), 2.0, shift=(1.6, -1.2)), 100)
    assert match is not None
    assert match.older == 41
    assert np.linalg.norm(match.T_older_newer[:2, 3] - [1.6, -1.2]) < 1.5


def test_only_the_places_that_are_old_enough_are_looked_at():
    index = PlaceIndex(PlaceSettings())
    for seed in range(80):
        index.add(surroundings(seed))
    match = index.search(surroundings(63), 60)
    assert match is not None
    assert match.older < 60
    assert match.likeness < 0.55
    assert index.search(surroundings(63), 0) is None


def test_an_empty_place_matches_nothing():
    index = PlaceIndex(PlaceSettings())
    for points in (surroundings(1), np.zeros((0, 3), np.float32)):
        index.add(points)
    assert index.search(np.zeros((0, 3), np.float32), 2) is None
