"""An office floor: three corridors, rooms and all, that are the same to the millimetre; a lobby that is not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place
from splitslam.sim.places.furniture import potted_plant, shelf
from splitslam.sim.places.materials import CLOTH, CONCRETE, GLASS, METAL, PAVING, PLASTER, SIGN, WOOD
from splitslam.sim.places.ways import Waypoints, rounded

Array = NDArray[np.float64]

SPACING_M = 8.4  # from one corridor's middle to the next
CORRIDORS = 3
LENGTH_M = 13.0  # two modules
_MODULE_M, _HALF_M, _ROOM_M = 6.5, 1.15, 3.0
_HALL_M = 2.6
_HIGH_M = 2.7


def through_all_corridors() -> Waypoints:
    """Out of the lobby, up through the three corridors, down the eastern hall, back through the first to the lobby."""
    west, east, top = -_HALL_M / 2, LENGTH_M + _HALL_M / 2, 2 * SPACING_M
    corners = ((-7.4, 0.0), (east, 0.0), (east, SPACING_M), (west, SPACING_M), (west, top), (east, top),
               (east, 0.0), (-7.4, 0.0))  # fmt: skip
    return rounded(corners, 1.2, 1.1, closed=False)


def build_twins(seed: int) -> Place:
    """The seed furnishes the lobby; all else is repeated."""
    rng = np.random.default_rng([seed, 0x7B])
    mesh = Mesh()
    for k in range(CORRIDORS):
        with mesh.at((0.0, k * SPACING_M + _HALF_M, 0.0)):
            _rooms(mesh)
        with mesh.at((LENGTH_M, k * SPACING_M - _HALF_M, 0.0), np.pi):
            _rooms(mesh)
    _halls(mesh)
    _lobby(mesh, rng)
    triangles, reflectivity = mesh.arrays()
    east = LENGTH_M + 2.0
    walkways = ((-6.5, -2.8, -3.5, -3.0), (east, 1.0, east, 15.0), (1.0, 0.7, 12.0, 0.7), (1.0, 9.1, 12.0, 9.1))
    return Place(triangles, reflectivity, _floor, walkways)


def _floor(x: Array, y: Array) -> Array:
    """What the wheels feel; millimetres, and the same in each corridor."""
    return 0.001 * np.sin(2.3 * x) + 0.001 * np.sin(2 * np.pi * y / SPACING_M)


def _rooms(mesh: Mesh) -> None:
    """One side of a corridor, its wall along x from the origin, rooms on the side of +y; doors stand open."""
    for k in range(round(LENGTH_M / _MODULE_M)):
        with mesh.at((k * _MODULE_M, 0.0, 0.0)):
            for a, b in ((0.0, 1.6), (2.6, _MODULE_M)):
                mesh.slab((a, 0.06), (b, 0.06), 0.0, (0.12, _HIGH_M), reflectivity=PLASTER)
            mesh.slab((1.6, 0.06), (2.6, 0.06), 2.1, (0.12, _HIGH_M - 2.1), reflectivity=PLASTER)
            mesh.slab((1.62, 0.1), (1.5, 1.0), 0.0, (0.05, 2.1), reflectivity=WOOD)  # the door
            for a in (1.55, 2.65):
                mesh.box((a, 0.0, 0.0), (0.1, 0.18, 2.2), reflectivity=METAL)
            mesh.box((0.0, 0.0, 0.0), (0.35, 0.3, _HIGH_M), reflectivity=CONCRETE)
            mesh.box((4.2, -0.03, 1.1), (1.5, 0.06, 0.9), reflectivity=CLOTH)  # a board
            mesh.box((5.6, -0.1, 0.8), (0.25, 0.2, 0.6), reflectivity=METAL)  # a fire extinguisher's case
            mesh.slab((0.06, 0.0), (0.06, _ROOM_M), 0.0, (0.12, _HIGH_M), reflectivity=PLASTER)
            mesh.slab((0.0, _ROOM_M), (_MODULE_M, _ROOM_M), 0.0, (0.1, _HIGH_M), reflectivity=PLASTER)
            mesh.box((3.4, _ROOM_M - 0.5, 0.0), (1.6, 0.8, 0.74), reflectivity=WOOD)
            mesh.box((3.2, 1.7, 0.0), (0.5, 0.5, 0.9), reflectivity=CLOTH)
            mesh.box((5.9, 1.8, 0.0), (0.5, 1.6, 2.0), reflectivity=WOOD)
    mesh.slab((LENGTH_M, 0.0), (LENGTH_M, _ROOM_M), 0.0, (0.12, _HIGH_M), reflectivity=PLASTER)


def _halls(mesh: Mesh) -> None:
    """Both halls across the corridors' ends, windows outside; floor and ceiling of all."""
    low, high = -_HALF_M - _ROOM_M - 0.1, (CORRIDORS - 1) * SPACING_M + _HALF_M + _ROOM_M + 0.1
    x0, x1 = -10.0, LENGTH_M + _HALL_M
    for z, material in ((0.0, PAVING), (_HIGH_M, PLASTER)):
        corners = [[x0, low - 1.0, z], [x1, low - 1.0, z], [x1, high, z], [x0, high, z]]
        mesh.quads(np.array([corners]), reflectivity=material)
    for x, outside in ((-_HALL_M, -1.0), (x1, 1.0)):
        for k in range(CORRIDORS):
            y = k * SPACING_M
            lobby = outside < 0 and k == 0
            parts = ((-4.2, -1.6), (1.6, 4.2)) if lobby else ((-4.2, 4.2),)
            for a, b in parts:
                mesh.slab((x, y + a), (x, y + b), 0.0, (0.2, 0.9), reflectivity=PLASTER)
                mesh.slab((x, y + a), (x, y + b), 2.2, (0.2, _HIGH_M - 2.2), reflectivity=PLASTER)
                mesh.slab((x, y + a), (x, y + b), 0.9, (0.03, 1.3), reflectivity=GLASS)
            for at in (-4.2, -1.7, 1.7):
                mesh.box((x, y + at, 0.0), (0.35, 0.35, _HIGH_M), reflectivity=CONCRETE)
            for z in (0.15, 0.5):  # radiators
                mesh.box((x - outside * 0.18, y + 2.9, z), (0.1, 1.4, 0.25), reflectivity=METAL)
    for y in (low, high):
        mesh.slab((-_HALL_M, y), (x1, y), 0.0, (0.2, _HIGH_M), reflectivity=PLASTER)


def _lobby(mesh: Mesh, rng: np.random.Generator) -> None:
    low, high = -4.2, 4.2
    for a, b in (((-10.0, low), (-_HALL_M, low)), ((-10.0, high), (-_HALL_M, high)), ((-10.0, low), (-10.0, high))):
        mesh.slab(a, b, 0.0, (0.2, _HIGH_M), reflectivity=PLASTER)
    mesh.box((-8.9, 0.3, 0.0), (0.7, 2.6, 1.1), reflectivity=WOOD)  # the counter
    mesh.frustum((-4.6, 2.4, 0.0), (0.25, 0.25), _HIGH_M, 16, reflectivity=CONCRETE)
    mesh.box((-6.5, 3.6, 0.0), (2.2, 0.8, 0.45), reflectivity=CLOTH)
    mesh.box((-6.5, 3.95, 0.45), (2.2, 0.2, 0.45), reflectivity=CLOTH)
    mesh.box((-3.4, -3.4, 0.0), (0.8, 0.8, 1.9), float(rng.normal(0, 0.1)), reflectivity=METAL)
    mesh.box((-9.85, -2.0, 1.2), (0.05, 1.6, 0.9), reflectivity=SIGN)
    potted_plant(mesh, -3.4, 3.5, rng)
    potted_plant(mesh, -9.2, -3.4, rng)
    with mesh.at((-7.0, -3.9, 0.0)):
        shelf(mesh, rng)
