"""Shapes and ways that places are made of."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam.sim.mesh import Mesh
from splitslam.sim.places.ways import rounded
from splitslam.sim.spec import PathSpec, SpeedChange
from splitslam.sim.trajectory import make_trajectory
from tests.sim.test_wheels import SPEC, make_world


def test_frames_of_a_mesh_nest() -> None:
    mesh = Mesh()
    with mesh.at((10.0, 0.0, 1.0), np.pi / 2), mesh.at((2.0, 0.0, 0.0), np.pi / 2):
        mesh.quads(np.array([[[1.0, 0, 0], [1.0, 1.0, 0], [1.0, 1.0, 1.0], [1.0, 0, 1.0]]]), reflectivity=1)
    mesh.box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), reflectivity=2)
    triangles, reflectivity = mesh.arrays()
    np.testing.assert_allclose(triangles[0, 0], [9.0, 2.0, 1.0], atol=1e-6)
    assert np.abs(triangles[reflectivity == 2]).max() == 1.0, "outside the frames nothing is moved"


def test_rounded_corners_touch_both_legs_and_keep_the_radius() -> None:
    way = np.array(rounded(((0.0, 0.0), (20.0, 0.0), (20.0, 30.0)), 5.0, 1.0, closed=False))
    assert way[0].tolist() == [0.0, 0.0]
    assert way[-1].tolist() == [20.0, 30.0]
    in_the_bend = (way[:, 0] > 15.001) & (way[:, 1] < 4.999)
    assert in_the_bend.sum() >= 5
    np.testing.assert_allclose(np.linalg.norm(way[in_the_bend] - [15.0, 5.0], axis=1), 5.0)
    steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
    assert steps.min() > 0.7
    assert steps.max() < 1.3


def test_a_closed_way_is_rounded_at_every_corner() -> None:
    way = np.array(rounded(((0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)), 4.0, 1.0, closed=True))
    length = np.linalg.norm(np.diff(np.vstack([way, way[:1]]), axis=0), axis=1).sum()
    assert length == pytest.approx(4 * 12.0 + 2 * np.pi * 4.0, rel=0.005)


def test_speed_changes_are_smooth_and_follow_each_other() -> None:
    way = tuple((float(x), 0.0) for x in range(0, 61, 5))
    path = PathSpec(way, closed=False, speed_mps=2.0, stand_s=1.0, accel_s=1.0, gait=0.0,
                    speed_changes=(SpeedChange(4.0, 5.0, 2.0), SpeedChange(8.0, 0.0, 1.0)))  # fmt: skip
    motion = make_trajectory(path, make_world(SPEC.world).place, 10.0).motion(np.array([0.5, 3.0, 7.0, 9.5]))
    np.testing.assert_allclose(np.linalg.norm(motion.velocity_mps, axis=1), [0.0, 2.0, 5.0, 0.0], atol=1e-3)
    # 1 m while it starts, 2 s at 2 m/s, 7 m while it gets faster, 2 s at 5 m/s, 2.5 m while it stops.
    assert motion.position_m[3, 0] == pytest.approx(1.0 + 4.0 + 7.0 + 10.0 + 2.5, abs=1e-3)
