"""Each drive is what its name says: a place with the geometry it promises, and a way that keeps clear of it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from splitslam.sim import DRIVES, DriveSpec
from splitslam.sim.lidar import FIRING_NS, LASERS, Vlp16
from splitslam.sim.people import walkers
from splitslam.sim.places import twins
from splitslam.sim.spec import WorldSpec
from splitslam.sim.trajectory import Trajectory, drive_trajectory
from splitslam.sim.world import Hits, World, make_world
from tests.tolerances import TABLE_1_ELEVATION_M, TABLE_1_RELATIVE

Array = NDArray[np.float64]

ALL = pytest.mark.parametrize("name", DRIVES)


@cache
def _drive(name: str) -> tuple[DriveSpec, World, Trajectory]:
    spec = DRIVES[name]
    world = make_world(spec.world)
    return spec, world, drive_trajectory(spec, world.place)


def _scan(spec: DriveSpec, world: World, trajectory: Trajectory, at_s: float) -> tuple[Hits, Array]:
    """What every third firing of one turn meets within the sensor's range, and the beams (N, 3)."""
    first = round(at_s * 1e9 / FIRING_NS)
    _, origins, directions = Vlp16(spec, world, trajectory).rays(np.arange(first, first + 1808, 3))
    hits = world.cast(origins, directions)
    near = np.flatnonzero(hits.range_m < spec.lidar.max_range_m)
    return hits[near], directions[near]


def _constraint(hits: Hits) -> tuple[Array, Array]:
    """Eigenvalues (3,), smallest first, and vectors (columns) of the mean of n n^T: how planes hold a translation."""
    return np.linalg.eigh(hits.normal.T @ hits.normal / len(hits.normal))


@ALL
def test_the_way_keeps_clear_of_every_surface(name: str) -> None:
    spec, world, trajectory = _drive(name)
    t_s = np.arange(0.0, spec.duration_s, max(0.2, spec.duration_s / 1_000))
    turn = np.radians(np.arange(0.0, 360.0, 5.0))
    around = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
    position = trajectory.poses(t_s)[1]
    origins = np.repeat(position, len(around), axis=0)
    free_m = world.cast(origins, np.tile(around, (len(position), 1))).range_m
    assert free_m.min() > spec.lidar.min_range_m
    below = world.cast(position, np.tile([0.0, 0.0, -1.0], (len(position), 1))).range_m
    assert below.min() > 0.7 * spec.path.height_m, "the ground is where the sensor's bearer walks or drives"
    assert below.max() < 1.3 * spec.path.height_m


@ALL
def test_people_keep_clear_of_the_sensor_whatever_the_seed(name: str) -> None:
    spec, world, trajectory = _drive(name)
    t_s = np.arange(0.0, spec.duration_s, 0.1)
    way = trajectory.poses(t_s)[1][:, :2]
    for seed in range(1, 6):
        people = walkers(world.place, 6, seed, t_s, way)
        assert len(people) == 6
        assert min(np.linalg.norm(walker.positions(t_s) - way, axis=1).min() for walker in people) > 0.6


@ALL
def test_a_scan_has_as_many_returns_as_places_of_its_kind_give(name: str) -> None:
    spec, world, trajectory = _drive(name)
    sweep = next(Vlp16(replace(spec, duration_s=5.0), world, trajectory).sweeps())
    assert (sweep.range_m > 0).mean() > 0.45


def test_the_corridor_says_nothing_about_the_way_along_it_for_twenty_seconds() -> None:
    spec, world, trajectory = _drive("corridor")
    t_s = np.arange(0.5, spec.duration_s - 0.5, 0.5)
    least, along = np.empty(len(t_s)), np.empty(len(t_s))
    for k, at in enumerate(t_s):
        values, vectors = _constraint(_scan(spec, world, trajectory, float(at))[0])
        least[k], along[k] = values[0] / values[2], abs(vectors[0, 0])
    blind = least < 1e-6
    inside = np.flatnonzero(blind)
    assert (np.diff(inside) == 1).all(), "one stretch"
    assert len(inside) * 0.5 >= 20.0
    assert along[blind].min() > 0.9999, "and it is the direction of the tunnel that is not seen"
    assert least[t_s < 4.0].min() > 0.02, "the drive begins where all directions are seen"
    assert least[t_s > 50.0].min() > 0.02, "and ends there"


def test_the_other_places_say_something_about_every_direction() -> None:
    for name in ("campus", "park", "street", "twins"):
        spec, world, trajectory = _drive(name)
        least = [_constraint(_scan(spec, world, trajectory, float(at))[0])[0] for at in np.arange(3.0, 40.0, 6.0)]
        assert min(values[0] / values[2] for values in least) > 0.005, name


def test_the_twin_corridors_cannot_be_told_apart_by_what_stands_in_them() -> None:
    spec, world, _ = _drive("twins")
    turn, elevation = np.meshgrid(np.radians(np.arange(0.0, 360.0, 0.5)), np.radians(np.arange(-15.0, 16.0, 2.0)))
    beams = np.stack([np.cos(elevation) * np.cos(turn), np.cos(elevation) * np.sin(turn), np.sin(elevation)], axis=-1)
    beams = beams.reshape(-1, 3)
    for x in (3.0, 7.0, 11.0):
        ranges = [
            world.cast(np.tile([x, k * twins.SPACING_M, spec.path.height_m], (len(beams), 1)), beams).range_m
            for k in range(twins.CORRIDORS)
        ]
        same = [(np.abs(a - b) < 1e-3).mean() for a, b in itertools.combinations(ranges, 2)]
        assert same[2] > 0.999, "second and third"
        assert min(same) > 0.9, "from the first one sees the lobby, through one door"


def test_the_twins_end_with_a_revisit_of_the_first_corridor_and_the_lobby() -> None:
    spec, _, trajectory = _drive("twins")
    t_s = np.arange(0.0, spec.duration_s, 0.1)
    way = trajectory.poses(t_s)[1]
    first, last = way[t_s < 12.0], way[t_s > 46.0]
    assert np.linalg.norm(last[:, None] - first[None], axis=2).min(axis=1).max() < 0.2
    assert np.abs(way[(t_s > 15.0) & (t_s < 40.0), 1]).min() > 1.0, "in between it is elsewhere"


def test_the_vehicle_starts_and_stops_hard_and_reaches_nine_metres_a_second() -> None:
    spec, _, trajectory = _drive("street")
    motion = trajectory.motion(np.arange(0.0, spec.duration_s, 0.02))
    speed = np.linalg.norm(motion.velocity_mps[:, :2], axis=1)
    assert speed.max() == pytest.approx(9.0, abs=0.02)
    assert np.diff(speed).max() / 0.02 > 4.5
    assert np.diff(speed).min() / 0.02 < -6.5
    standing = np.flatnonzero(speed < 1e-6)
    assert len(np.split(standing, np.flatnonzero(np.diff(standing) > 1) + 1)) == 2, "at the start and once on the way"


def test_a_moving_start_is_at_full_speed_in_the_first_scan() -> None:
    trajectory = _drive("moving_start")[2]
    velocity = trajectory.motion(np.array([0.0, 0.1])).velocity_mps
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), 9.0, atol=0.05)


def test_the_park_is_hilly_and_heads_turn_at_two_hundred_degrees_a_second() -> None:
    spec, world, trajectory = _drive("park")
    motion = trajectory.motion(np.arange(0.0, spec.duration_s, 0.01))
    assert np.degrees(np.linalg.norm(motion.omega_radps, axis=1).max()) == pytest.approx(200.0, rel=0.05)
    assert np.ptp(motion.position_m[:, 2]) > 3.5
    hits, _ = _scan(spec, world, trajectory, 25.0)
    sky = np.abs(hits.normal[:, 2])
    assert ((sky < 0.05) | (sky > 0.999)).mean() < 0.2, "hardly a wall, hardly a level floor"


@pytest.mark.parametrize(
    ("name", "scans", "elevation_m", "length_m", "turn_dps"),
    [
        ("paper_walking", 6502, 0.3, 801.0, 133.7),
        ("paper_campus", 9865, 1.0, 1437.0, 124.8),
        ("paper_park", 24691, 19.0, 2898.0, 217.4),
    ],
)
def test_the_long_drives_have_the_figures_of_table_1(
    name: str, scans: int, elevation_m: float, length_m: float, turn_dps: float
) -> None:
    spec, world, trajectory = _drive(name)
    assert Vlp16(spec, world, trajectory).scans == scans
    way = trajectory.poses(np.arange(scans) / spec.lidar.rate_hz)[1]
    assert np.ptp(way[:, 2]) == pytest.approx(elevation_m, abs=TABLE_1_ELEVATION_M, rel=TABLE_1_RELATIVE)
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).sum() == pytest.approx(length_m, rel=TABLE_1_RELATIVE)
    turning = trajectory.motion(np.arange(0.0, spec.duration_s, 0.02)).omega_radps
    assert np.degrees(np.linalg.norm(turning, axis=1).max()) == pytest.approx(turn_dps, rel=TABLE_1_RELATIVE)


def test_another_world_seed_moves_things_but_neither_way_nor_ground() -> None:
    x = np.linspace(-50.0, 50.0, 11)
    for kind in ("campus", "corridor", "street", "twins", "quarter"):
        one, two = (make_world(WorldSpec(kind, seed)).place for seed in (1, 2))
        assert one.triangles.shape != two.triangles.shape or not np.array_equal(one.triangles, two.triangles), kind
        np.testing.assert_array_equal(one.ground_m(x, x), two.ground_m(x, x))


def test_beams_go_clockwise_and_the_lowest_laser_looks_down() -> None:
    spec, world, trajectory = _drive("corridor")
    _, _, directions = Vlp16(spec, world, trajectory).rays(np.array([0, 100]))
    first, later = directions.reshape(2, LASERS, 3)
    assert first[0, 0] * later[0, 1] - first[0, 1] * later[0, 0] < 0.0
    assert first[0, 2] == pytest.approx(np.sin(np.radians(-15.0)), abs=0.01)
