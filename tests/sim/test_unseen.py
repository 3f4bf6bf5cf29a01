"""What the drives of `benchmarks.unseen` need: sensors that fly, are carried level, see a part of a turn."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from benchmarks.unseen_drives import UNSEEN
from splitslam.sim.grid_lidar import Grid, GridLidar
from splitslam.sim.recorder import robot_file
from splitslam.sim.spec import Climb, DriveSpec, WorldSpec
from splitslam.sim.trajectory import Trajectory, drive_trajectory
from splitslam.sim.world import World, make_world

Array = NDArray[np.float64]
FRONT = Grid(8, 60, (-12.5, 12.5), 120.0)


@cache
def _drive(name: str) -> tuple[DriveSpec, World, Trajectory]:
    spec = UNSEEN[name].spec
    world = make_world(spec.world)
    return spec, world, drive_trajectory(spec, world.place)


@pytest.mark.parametrize("name", ["house", "plain", "climb"])
def test_the_way_keeps_clear_of_every_surface(name: str) -> None:
    spec, world, trajectory = _drive(name)
    t_s = np.arange(0.0, spec.duration_s, 0.1)
    turn = np.radians(np.arange(0.0, 360.0, 5.0))
    around = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
    position = trajectory.poses(t_s)[1]
    free_m = world.cast(np.repeat(position, len(around), axis=0), np.tile(around, (len(position), 1))).range_m
    assert free_m.min() > 0.25, "a hand's breadth more than the sensor is wide"


def test_the_house_is_narrow_and_its_stairs_lead_up() -> None:
    spec, world, trajectory = _drive("house")
    t_s = np.arange(0.0, spec.duration_s, 0.2)
    R, position = trajectory.poses(t_s)
    assert np.ptp(position[:, 2]) > 2.6
    assert np.degrees(np.arccos(R[:, 2, 2])).max() < 3.0, "carried level, on the stairs too"
    feet = world.cast(position, np.tile([0.0, 0.0, -1.0], (len(position), 1))).range_m
    assert 0.6 * spec.path.height_m < feet.min()
    assert feet.max() < 1.4 * spec.path.height_m
    sides = np.concatenate([R[:, :, 1], -R[:, :, 1]])
    assert np.median(world.cast(np.tile(position, (2, 1)), sides).range_m) < 2.0


def test_it_turns_as_fast_as_it_says() -> None:
    spec, _, trajectory = _drive("house")
    omega = trajectory.motion(np.arange(0.0, spec.duration_s, 0.01)).omega_radps
    assert 150.0 < np.degrees(np.abs(omega).max()) < 240.0


def test_the_plain_has_little_beside_its_ground() -> None:
    _, world, trajectory = _drive("plain")
    position = trajectory.poses(np.arange(10.0, 32.0, 0.5))[1]
    turn = np.radians(np.arange(0.0, 360.0, 2.0))
    around = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
    hits = world.cast(np.repeat(position, len(around), axis=0), np.tile(around, (len(position), 1)))
    assert np.mean(hits.range_m < 60.0) < 0.35
    speed = np.linalg.norm(trajectory.motion(np.arange(12.0, 30.0)).velocity_mps[:, :2], axis=1)
    np.testing.assert_allclose(speed, 20.0, atol=0.1)


def test_a_climb_goes_up_where_it_says_and_comes_back_by_as_much() -> None:
    spec, world, trajectory = _drive("climb")
    up = replace(spec, path=replace(spec.path, climbs=(Climb(5.0, 4.0, 2.0), Climb(9.0, -4.0, 2.0))))
    flying, level = (drive_trajectory(s, world.place) for s in (up, replace(up, path=replace(up.path, climbs=()))))
    t_s = np.array([4.9, 6.0, 8.0, 11.1])
    np.testing.assert_allclose(flying.poses(t_s)[1][:, 2] - level.poses(t_s)[1][:, 2], [0.0, 2.0, 4.0, 0.0], atol=1e-6)
    assert trajectory.motion(np.array([10.5])).velocity_mps[0, 2] > 3.0


def test_a_narrow_field_is_swept_once_a_scan_from_left_to_right() -> None:
    spec, world, trajectory = _drive("walk")
    scan = next(GridLidar(FRONT, replace(spec, duration_s=1.0), world, trajectory).sweeps())
    azimuth = np.degrees(np.arctan2(scan.points_lidar[:, 1], scan.points_lidar[:, 0]))
    elevation = np.degrees(np.arctan2(scan.points_lidar[:, 2], np.hypot(*scan.points_lidar[:, :2].T)))
    np.testing.assert_allclose(azimuth, 60.0 - 120.0 * scan.t_offset_ns / 1e8, atol=0.01)
    assert np.abs(elevation).max() < 12.51


def test_the_robot_file_counts_the_columns_of_a_whole_turn() -> None:
    robot = yaml.safe_load(robot_file(replace(UNSEEN["walk"].spec, world=WorldSpec("house")), FRONT))
    assert robot["lidar"]["columns"] == 180
    assert robot["lidar"]["beam_elevations_deg"][-1] == 12.5
