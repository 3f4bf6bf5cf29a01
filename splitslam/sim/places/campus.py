"""A campus yard: a pavilion in the middle, buildings on three sides, a street in the south, a green in the west."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place
from splitslam.sim.places.buildings import building
from splitslam.sim.places.furniture import bench, car, lamp, tree
from splitslam.sim.places.materials import (
    BRICK,
    CONCRETE,
    GLASS,
    LEAVES,
    METAL,
    PAVING,
    PLASTER,
    ROOF,
    SIGN,
    STONE,
    WOOD,
)

Array = NDArray[np.float64]


def build_campus(seed: int) -> Place:
    """120 m x 120 m. The seed moves trees, cars, benches and the roughness of the grass; the buildings stay."""
    rng = np.random.default_rng([seed, 0xCA])
    mesh = Mesh()
    mesh.ground((-60.0, -60.0), (60.0, 60.0), 1.0, _rough_ground(rng), reflectivity=PAVING)
    _pavilion(mesh)
    building(mesh, (-6.0, 21.0), (46.0, 11.0), 10.5, storeys=3, reflectivity=BRICK, door_at=0.2)
    building(mesh, (27.0, 1.0), (12.0, 22.0), 7.5, storeys=2, reflectivity=PLASTER, door_at=-0.25)
    building(mesh, (-38.0, -4.0), (9.0, 20.0), 5.0, storeys=1, reflectivity=CONCRETE, door_at=0.1)
    building(mesh, (12.0, -33.0), (18.0, 9.0), 8.0, storeys=2, reflectivity=PLASTER, door_at=0.3)
    building(mesh, (-14.0, -34.0), (22.0, 10.0), 6.5, storeys=2, reflectivity=BRICK, door_at=-0.1)
    _south_wall_and_street(mesh, rng)
    _green(mesh, rng)
    _yard(mesh, rng)
    triangles, reflectivity = mesh.arrays()
    walkways = ((11.5, -9.0, 11.0, 9.0), (-12.0, 9.5, 8.0, 10.5), (-13.5, -9.0, -12.0, 7.0), (-9.0, -10.0, 9.0, -9.5),
                (14.0, -12.0, 15.0, 12.0), (-22.0, -3.0, -12.5, 1.0))  # fmt: skip
    return Place(triangles, reflectivity, _smooth_ground, walkways)


def _smooth_ground(x: Array, y: Array) -> Array:
    """Height of the ways: paved ground is never quite flat."""
    return 0.05 * np.sin(0.21 * x + 0.4) * np.cos(0.17 * y) + 0.03 * np.sin(0.43 * y + 0.31 * x) + 0.004 * (x + y)


def _rough_ground(rng: np.random.Generator):
    def height_m(x: Array, y: Array) -> Array:
        grass = np.clip((-14.0 - x) / 3.0, 0.0, 1.0)
        return _smooth_ground(x, y) + grass * (
            0.12 + rng.normal(0.0, 0.035, x.shape) + 0.15 * np.sin(0.3 * x + 0.2 * y)
        )

    return height_m


def _pavilion(mesh: Mesh) -> None:
    """A kiosk with a colonnade: what the drive goes round."""
    mesh.box((0.0, 0.0, -0.3), (7.0, 4.4, 0.45), reflectivity=STONE)
    mesh.box((0.3, 0.3, 0.1), (4.6, 2.6, 2.9), reflectivity=PLASTER)
    mesh.box((-0.9, -1.02, 0.15), (1.0, 0.12, 2.1), reflectivity=WOOD)
    for x in (1.0, 2.0):
        mesh.box((x, -1.04, 1.1), (0.8, 0.16, 1.0), reflectivity=GLASS)
    mesh.box((0.3, 1.66, 0.9), (2.8, 0.3, 1.2), reflectivity=WOOD)
    for x in (-3.1, -1.05, 1.05, 3.1):
        for y in (-1.9, 1.9):
            mesh.frustum((x, y, 0.1), (0.16, 0.13), 2.8, reflectivity=STONE)
    mesh.box((0.0, 0.0, 2.9), (7.2, 4.6, 0.25), reflectivity=STONE)
    mesh.gable((0.0, 0.0, 3.15), (7.4, 4.9, 1.3), reflectivity=ROOF)
    mesh.box((-3.9, 0.6, -0.2), (0.6, 1.6, 1.0), reflectivity=METAL)


def _south_wall_and_street(mesh: Mesh, rng: np.random.Generator) -> None:
    for start, end in ((-30.0, -5.5), (-1.5, 21.0)):
        mesh.slab((start, -14.0), (end, -14.0), -0.3, (0.35, 2.0), reflectivity=BRICK)
        mesh.slab((start, -14.0), (end, -14.0), 1.7, (0.5, 0.12), reflectivity=STONE)
        for x in np.arange(start, end + 0.1, (end - start) / 6):
            mesh.box((float(x), -14.0, -0.3), (0.55, 0.55, 2.4), reflectivity=BRICK)
    for x in (-5.5, -1.5):
        mesh.frustum((x, -14.0, 2.1), (0.3, 0.05), 0.6, reflectivity=STONE)
    mesh.slab((21.0, -14.0), (21.0, -10.5), -0.3, (0.35, 2.0), reflectivity=BRICK)
    for y in (-17.0, -25.5):
        mesh.slab((-58.0, y), (58.0, y), -0.3, (0.3, 0.42), reflectivity=STONE)
    for x in (-40.0, -20.0, 0.5, 20.0, 40.0):
        lamp(mesh, x, -16.2, 6.5)
    x = -45.0
    while x < 45.0:
        car(mesh, x, -18.3 + rng.normal(0.0, 0.08), rng.normal(0.0, 0.02), rng)
        x += rng.uniform(5.2, 12.0)
    for x in (-24.0, 2.0, 26.0):
        tree(mesh, (x + rng.normal(0, 0.5), -26.8), rng.uniform(6, 8), rng)


def _green(mesh: Mesh, rng: np.random.Generator) -> None:
    spots = [
        (-17.0, -9.5),
        (-19.5, 2.0),
        (-17.5, 10.5),
        (-25.0, -6.0),
        (-26.5, 8.0),
        (-30.0, 14.0),
        (-23.0, -12.0),
        (-29.0, 0.5),
    ]
    for x, y in spots:
        tree(mesh, (x + rng.normal(0, 0.4), y + rng.normal(0, 0.4)), rng.uniform(4.5, 9.0), rng)
    for k in range(9):
        mesh.blob((-14.6 + rng.normal(0, 0.1), -7.5 + 1.2 * k, 0.45), (0.55, 0.75, 0.6), rng, reflectivity=LEAVES)
    for k in range(13):  # a fence behind the green
        y = -13.0 + 2.4 * k
        mesh.frustum((-33.0, y, -0.3), (0.05, 0.05), 1.7, 6, reflectivity=METAL)
    for z in (0.3, 0.8, 1.3):
        mesh.slab((-33.0, -13.0), (-33.0, 15.8), z, (0.05, 0.06), reflectivity=METAL)


def _yard(mesh: Mesh, rng: np.random.Generator) -> None:
    for y in (-12.5, 14.2):
        mesh.slab((-13.5, y), (20.0, y), -0.3, (0.25, 0.45), reflectivity=STONE)
    for x, y in ((11.8, -11.0), (-11.0, -11.4), (12.4, 12.6), (-11.3, 12.2), (19.4, 3.0)):
        lamp(mesh, x, y, 4.2)
    for x, y in ((17.5, -8.0), (16.8, 9.5), (4.5, 12.9), (-6.5, 13.1)):
        tree(mesh, (x, y), rng.uniform(4.0, 6.0), rng)
        mesh.frustum((x, y, -0.3), (0.95, 0.9), 0.75, 8, reflectivity=STONE)
    for x, y, yaw in ((-1.5, 12.4, 0.0), (9.8, 12.7, 0.0), (18.6, -2.5, np.pi / 2), (-11.8, -2.0, np.pi / 2)):
        bench(mesh, x + rng.normal(0, 0.2), y, yaw + rng.normal(0, 0.05))
    for k in range(6):  # bicycle stands
        mesh.slab((6.0 + 0.9 * k, -12.0), (6.0 + 0.9 * k, -11.0), 0.75, (0.06, 0.06), reflectivity=METAL)
        for y in (-12.0, -11.0):
            mesh.frustum((6.0 + 0.9 * k, y, -0.2), (0.03, 0.03), 1.0, 6, reflectivity=METAL)
    for x, y in ((12.6, 3.4), (-10.4, 9.0)):
        mesh.frustum((x, y, -0.2), (0.03, 0.03), 2.6, 6, reflectivity=METAL)
        mesh.box((x + 0.04, y, 1.9), (0.02, 0.6, 0.45), 0.4, reflectivity=SIGN)
    mesh.frustum((-9.6, -10.3, -0.2), (0.3, 0.28), 1.2, reflectivity=METAL)
    car(mesh, 15.0, -10.6, 1.45, rng)
    car(mesh, 17.9, -10.9, 1.6, rng)
