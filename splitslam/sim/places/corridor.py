"""A service tunnel between a lobby and a hall: nothing in it tells how far along one is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place
from splitslam.sim.places.furniture import bench, potted_plant, shelf
from splitslam.sim.places.materials import CONCRETE, GLASS, METAL, PAVING, PLASTER, SIGN, STONE, WOOD
from splitslam.sim.places.ways import Waypoints, rounded

Array = NDArray[np.float64]

TUNNEL_M = (0.0, 126.0)  # along x
_HALF_M, _HIGH_M = 1.35, 2.7
_LOBBY_M, _HALL_M = (-14.0, 0.0), (126.0, 150.0)
_ROOM_HIGH_M = 4.2


def through_the_tunnel() -> Waypoints:
    """From the lobby through the tunnel, a little to and fro between its walls, into the hall and round there."""
    weave = [(x, 0.1 * np.sin(0.19 * x)) for x in np.arange(6.0, 124.0, 8.0)]
    hall = ((130.0, 0.0), (143.0, -0.4), (145.0, 5.5), (134.0, 6.0))
    return rounded(((-10.5, -5.0), (-8.0, 0.4), (-2.0, 0.1), *weave, *hall), 2.2, 1.5, closed=False)


def build_corridor(seed: int) -> Place:
    """Walls, rails, light strip and drain run on unchanged for 126 m; the seed furnishes the rooms at both ends."""
    rng = np.random.default_rng([seed, 0xC0])
    mesh = Mesh()
    _tunnel(mesh)
    _room(mesh, _LOBBY_M, 9.0, door_in=+1)
    _room(mesh, _HALL_M, 11.0, door_in=-1)
    _lobby(mesh, rng)
    with mesh.at((_HALL_M[0], 0.0, 0.0)):
        _hall(mesh, rng)
    triangles, reflectivity = mesh.arrays()
    walkways = ((-12.0, 5.0, -3.0, 6.5), (2.0, 0.75, 60.0, 0.75), (129.0, -6.0, 146.0, -5.5), (60.0, -0.8, 120.0, -0.8))
    return Place(triangles, reflectivity, _floor, walkways)


def _floor(x: Array, y: Array) -> Array:
    """What the wheels feel; millimetres, so that the surfaces stay flat."""
    return 0.0015 * np.sin(2.9 * x + 1.1 * y) + 0.001 * np.sin(1.3 * x - 2.1 * y)


def _tunnel(mesh: Mesh) -> None:
    x0, x1 = TUNNEL_M
    h = _HIGH_M
    for y in (-_HALF_M, _HALF_M):
        mesh.quads(np.array([[[x0, y, 0], [x1, y, 0], [x1, y, h], [x0, y, h]]]), reflectivity=PLASTER)
        inner = y - np.sign(y) * 0.06
        mesh.box(((x0 + x1) / 2, inner, 0.9), (x1 - x0, 0.05, 0.16), reflectivity=WOOD)  # a handrail
        mesh.box(((x0 + x1) / 2, y - np.sign(y) * 0.02, 0.0), (x1 - x0, 0.04, 0.12), reflectivity=STONE)
    for z, material in ((0.0, PAVING), (h, CONCRETE)):
        floor = [[x0, -_HALF_M, z], [x1, -_HALF_M, z], [x1, _HALF_M, z], [x0, _HALF_M, z]]
        mesh.quads(np.array([floor]), reflectivity=material)
    mesh.box(((x0 + x1) / 2, 0.0, h - 0.09), (x1 - x0, 0.22, 0.09), reflectivity=GLASS)  # a light strip
    mesh.box(((x0 + x1) / 2, 0.95, h - 0.3), (x1 - x0, 0.3, 0.1), reflectivity=METAL)  # a cable tray
    for y, z, r in ((-1.1, h - 0.25, 0.09), (-0.85, h - 0.2, 0.06)):  # pipes
        mesh.box(((x0 + x1) / 2, y, z), (x1 - x0, 2 * r, 2 * r), reflectivity=METAL)


def _room(mesh: Mesh, x: tuple[float, float], half_m: float, door_in: int) -> None:
    """Four walls with an opening where the tunnel is, floor and ceiling; pilasters every 3 m."""
    (x0, x1), h = x, _ROOM_HIGH_M
    middle, length = (x0 + x1) / 2, x1 - x0
    mesh.quads(np.array([[[x0, -half_m, z], [x1, -half_m, z], [x1, half_m, z], [x0, half_m, z]] for z in (0.0, h)]),
               reflectivity=STONE)  # fmt: skip
    for y in (-half_m, half_m):
        mesh.slab((x0, y), (x1, y), 0.0, (0.3, h), reflectivity=PLASTER)
        for k in np.arange(x0 + 1.5, x1, 3.0):
            mesh.box((float(k), y - np.sign(y) * 0.25, 0.0), (0.4, 0.3, h), reflectivity=CONCRETE)
    closed, opened = (x0, x1) if door_in > 0 else (x1, x0)
    mesh.slab((closed, -half_m), (closed, half_m), 0.0, (0.3, h), reflectivity=PLASTER)
    for side in (-1, 1):
        mesh.slab((opened, side * _HALF_M), (opened, side * half_m), 0.0, (0.3, h), reflectivity=PLASTER)
    mesh.slab((opened, -_HALF_M), (opened, _HALF_M), _HIGH_M, (0.3, h - _HIGH_M), reflectivity=PLASTER)
    for beam in np.arange(x0 + 2.0, x1, 4.0):
        mesh.box((float(beam), 0.0, h - 0.35), (0.3, 2 * half_m, 0.35), reflectivity=CONCRETE)
    mesh.box((middle, half_m - 0.17, 1.0), (0.45 * length, 0.1, 2.0), reflectivity=GLASS)


def _lobby(mesh: Mesh, rng: np.random.Generator) -> None:
    mesh.box((-6.0, 7.2, 0.0), (3.4, 0.9, 1.15), reflectivity=WOOD)  # a counter
    mesh.box((-6.0, 8.3, 0.0), (2.6, 0.45, 2.0), 0.0, reflectivity=WOOD)
    for x, y in ((-11.0, 3.2), (-4.0, 4.4), (-4.0, -4.4)):
        mesh.frustum((x, y, 0.0), (0.3, 0.3), _ROOM_HIGH_M, 16, reflectivity=CONCRETE)
    for k in range(3):
        bench(mesh, -2.0 - 2.6 * k, -7.9 + float(rng.normal(0, 0.1)), float(rng.normal(np.pi, 0.05)))
    mesh.box((-13.2, 0.5, 0.0), (0.6, 1.4, 2.3), reflectivity=WOOD)
    for x, y in ((-12.8, 7.8), (-1.2, 7.9)):
        potted_plant(mesh, x, y, rng)
    mesh.box((-0.35, 3.0, 1.7), (0.04, 1.0, 0.6), reflectivity=SIGN)


def _hall(mesh: Mesh, rng: np.random.Generator) -> None:
    """In a frame whose x starts at the hall's door."""
    for x in (5.0, 12.0):
        for y in (-3.2, 3.2, 9.0):
            mesh.box((x, y, 0.0), (0.55, 0.55, _ROOM_HIGH_M), reflectivity=CONCRETE)
    for y in (-9.8, -7.6):
        for k in range(4):
            with mesh.at((4.5 + 4.4 * k, y, 0.0)):
                shelf(mesh, rng)
    for step in range(9):  # stairs to a gallery
        mesh.box((15.0 + 0.3 * step, 9.9, 0.0), (0.3, 1.8, 0.18 * (step + 1)), reflectivity=STONE)
    mesh.box((20.7, 9.9, 0.0), (6.0, 1.8, 1.62), reflectivity=STONE)
    for k in range(4):
        x, y = rng.uniform(13.5, 16.5), rng.uniform(-4.0, -2.0)
        mesh.box((float(x), float(y), 0.0), (1.2, 0.8, float(rng.uniform(0.15, 1.4))), float(rng.uniform(0, 3)),
                 reflectivity=WOOD)  # fmt: skip
    for x, y in ((22.6, -1.0), (2.0, 9.6)):
        potted_plant(mesh, x, y, rng)
    mesh.box((23.7, 2.0, 0.0), (0.4, 2.4, 2.4), reflectivity=METAL)
