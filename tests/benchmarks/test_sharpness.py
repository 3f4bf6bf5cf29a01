from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import scoring, sharpness
from splitslam import se3
from splitslam.alignment import interpolate
from splitslam.tum import Trajectory
from tests.benchmarks.made import SCAN_NS, scans, walk

NOISE_M = 0.01
RAYS = 8000
STAMPS = scans(4.0)
TRUTH = walk(np.arange(-3000, 7000, 10, dtype=np.int64) * 1_000_000)  # every 10 ms
Scans = list[tuple[int, np.ndarray, np.ndarray]]


@pytest.fixture(scope="module")
def seen() -> Scans:
    """A room of 16 m with noise along the rays, each point seen at its own time: skewed as a sensor skews it."""
    rng = np.random.default_rng(1)
    out = []
    for stamp in STAMPS:
        times = np.sort(rng.integers(0, SCAN_NS, RAYS))
        at = interpolate(TRUTH, stamp + times)
        R = np.array([se3.matrix_from_quat(q) for q in at.quats_xyzw])
        rays = rng.normal(size=(RAYS, 3))
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        world = np.einsum("nij,nj->ni", R, rays)
        walls = np.where(world > 0, 8.0 - at.positions_m, -8.0 - at.positions_m) / world
        range_m = walls.min(axis=1) + rng.normal(scale=NOISE_M, size=RAYS)
        out.append((int(stamp), rays * range_m[:, None], times))
    return out


def made_map(seen: Scans, system: Trajectory, offset_ns: int = 0) -> sharpness.MadeMap:
    return sharpness.place(seen, system, TRUTH, offset_ns)


def thickness_m(*maps: sharpness.MadeMap) -> tuple[float, ...]:
    result = sharpness.compare(list(maps))
    assert result is not None
    assert result.cells > 100
    return result.thickness_m


def test_the_thickness_of_a_plane_is_the_noise_of_its_points(seen: Scans):
    (thickness,) = thickness_m(made_map(seen, walk(STAMPS)))
    assert 0.5 * NOISE_M < thickness < NOISE_M  # the noise is along the ray, its part across the wall is less


def test_the_moment_that_a_system_stamps_makes_no_difference(seen: Scans):
    late = replace(walk(STAMPS + 80 * scoring.MS), stamps_ns=STAMPS)
    early_m, late_m = thickness_m(made_map(seen, walk(STAMPS)), made_map(seen, late, 80 * scoring.MS))
    assert early_m == pytest.approx(late_m, rel=0.02)


def test_a_trajectory_that_jitters_makes_planes_thicker_by_that_much(seen: Scans):
    jitter = np.random.default_rng(2).normal(scale=0.03, size=(len(STAMPS), 3))
    shaking = walk(STAMPS)
    shaking = replace(shaking, positions_m=shaking.positions_m + jitter)
    sharp_m, blurred_m = thickness_m(made_map(seen, walk(STAMPS)), made_map(seen, shaking))
    assert blurred_m > 2.5 * sharp_m


def test_where_a_map_lies_does_not_matter(seen: Scans):
    system = walk(STAMPS)
    T = se3.exp(np.array([0.2, 0.1, -1.5, 4.0, 5.0, 6.0]))
    poses = [T @ se3.from_quat(t, q) for t, q in zip(system.positions_m, system.quats_xyzw, strict=True)]
    quats = np.array([se3.quat_from_matrix(pose[:3, :3]) for pose in poses])
    moved = Trajectory(STAMPS, np.array([pose[:3, 3] for pose in poses]), quats)
    here_m, there_m = thickness_m(made_map(seen, system), made_map(seen, moved))
    assert here_m == pytest.approx(there_m, rel=1e-6)


def test_maps_that_share_no_plane_cannot_be_compared():
    nowhere = sharpness.MadeMap(np.random.default_rng(3).uniform(0, 100, size=(100, 3)), np.arange(100))
    assert sharpness.compare([nowhere, nowhere]) is None


def test_scans_without_a_pose_are_left_out(seen: Scans):
    half = made_map(seen, walk(STAMPS)[::2])
    assert set(half.scan.tolist()) == set(range(0, len(STAMPS), 2))


def test_a_map_that_is_all_blur_cannot_choose_the_planes_it_is_judged_by(seen: Scans):
    """Cells that are planes in the sharp map count for both, whichever comes first."""
    shaking = walk(STAMPS)
    jitter = np.random.default_rng(2).normal(scale=0.3, size=(len(STAMPS), 3))
    sharp, blurred = (
        made_map(seen, walk(STAMPS)),
        made_map(seen, replace(shaking, positions_m=shaking.positions_m + jitter)),
    )
    assert thickness_m(sharp, blurred) == thickness_m(blurred, sharp)[::-1]
    assert thickness_m(sharp, blurred)[1] > 0.08
