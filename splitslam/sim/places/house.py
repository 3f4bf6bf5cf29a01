"""A house of narrow rooms on two floors, the second behind a staircase: little room, quick turns, no far wall."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place
from splitslam.sim.places.materials import CLOTH, GLASS, PLASTER, STONE, WOOD
from splitslam.sim.places.ways import Waypoints, rounded

Array = NDArray[np.float64]

_STEPS, _TREAD_M, _RISE_M = 15, 0.28, 0.18
_STAIRS_M = _STEPS * _TREAD_M  # along x from 0 on
_UP_M = _STEPS * _RISE_M
_HIGH_M = 2.5  # a room
_HALL_M = 0.75  # half the hall's width
_DEEP_M = 3.2  # a room, off the hall
_ROOM_M = 3.6  # a room, along the hall
_DOOR_M = 0.5  # half of it
_ROOMS = 3  # on each side of each floor's hall
_BELOW_M = -_ROOMS * _ROOM_M
_ABOVE_M = _STAIRS_M + _ROOMS * _ROOM_M


def through_the_house() -> Waypoints:
    """Out of a room, into the one opposite, up the stairs, into a room there and out to the end of the hall."""
    below, across, above = (_room_middle(x0, k) for x0, k in ((_BELOW_M, 0), (_BELOW_M, 1), (_STAIRS_M, 1)))
    deep = _HALL_M + 0.5 * _DEEP_M
    turns = (
        *((below - 0.6, deep), (below, deep), (below, 0.0), (across, 0.0), (across, -deep), (across + 0.9, -deep)),
        *((across + 0.9, -deep + 0.9), (across, -deep + 0.9), (across, 0.0)),
        *((above, 0.0), (above, deep), (above - 0.9, deep), (above - 0.9, deep - 0.9), (above, deep - 0.9)),
        *((above, 0.0), (_ABOVE_M - 1.0, 0.0)),
    )
    return rounded(turns, 0.4, 0.3, closed=False)


def build_house(seed: int) -> Place:
    """Walls stay where they are; the seed furnishes."""
    rng = np.random.default_rng([seed, 0x40])
    mesh = Mesh()
    for x0, z in ((_BELOW_M, 0.0), (_STAIRS_M, _UP_M)):
        with mesh.at((x0, 0.0, z)):
            _storey(mesh, rng)
    _staircase(mesh)
    triangles, reflectivity = mesh.arrays()
    return Place(triangles, reflectivity, _tread, ((_BELOW_M + 1.0, 0.0, -1.0, 0.0),))


def _tread(x: Array, y: Array) -> Array:
    """What a bearer's arm makes of floors and steps: the mean over a pace."""
    pace = np.linspace(-0.35, 0.35, 15)
    return np.interp(x[..., None] + pace, (0.0, _STAIRS_M), (0.0, _UP_M)).mean(axis=-1) + 0.0 * y


def _room_middle(x0: float, k: int) -> float:
    return x0 + (k + 0.5) * _ROOM_M


def _storey(mesh: Mesh, rng: np.random.Generator) -> None:
    """Rooms on both sides of a hall along x; in a frame whose origin is the hall's beginning."""
    length, outer = _ROOMS * _ROOM_M, _HALL_M + _DEEP_M
    for z in (0.0, _HIGH_M):
        mesh.quads(np.array([[[0, -outer, z], [length, -outer, z], [length, outer, z], [0, outer, z]]]),
                   reflectivity=WOOD if z == 0.0 else PLASTER)  # fmt: skip
    for side in (-1.0, 1.0):
        _wall(mesh, (0.0, side * outer), (length, side * outer))
        for k in range(_ROOMS + 1):
            _wall(mesh, (k * _ROOM_M, side * _HALL_M), (k * _ROOM_M, side * outer))
        for k in range(_ROOMS):
            middle = _room_middle(0.0, k)
            for a, b in ((k * _ROOM_M, middle - _DOOR_M), (middle + _DOOR_M, (k + 1) * _ROOM_M)):
                _wall(mesh, (a, side * _HALL_M), (b, side * _HALL_M))
            mesh.slab((middle - _DOOR_M, side * _HALL_M), (middle + _DOOR_M, side * _HALL_M), 2.05, (0.12, 0.45),
                      reflectivity=PLASTER)  # fmt: skip
            with mesh.at((middle, side * _HALL_M, 0.0), 0.0 if side > 0 else np.pi):
                _furnish(mesh, rng)


def _wall(mesh: Mesh, a: tuple[float, float], b: tuple[float, float]) -> None:
    mesh.slab(a, b, 0.0, (0.12, _HIGH_M), reflectivity=PLASTER)


def _furnish(mesh: Mesh, rng: np.random.Generator) -> None:
    """Along a room's walls; in a frame whose origin is its door and whose y axis looks in."""
    back, aside = _DEEP_M - 0.1, _ROOM_M / 2 - 0.1
    mesh.box((float(rng.uniform(-0.4, 0.4)), back - 0.02, 0.9), (1.2, 0.06, 1.2), reflectivity=GLASS)  # a window
    if rng.random() < 0.5:
        mesh.box((aside - 0.45, back - 1.0, 0.0), (0.9, 1.9, 0.5), reflectivity=CLOTH)  # a bed
    else:
        mesh.box((aside - 0.3, back - 0.8, 0.7), (0.6, 1.3, 0.05), reflectivity=WOOD)  # a desk
        mesh.box((aside - 0.3, back - 1.3, 0.0), (0.5, 0.05, 0.7), reflectivity=WOOD)
    with mesh.at((-aside, float(rng.uniform(0.8, 1.2)), 0.0)):
        _bookcase(mesh, rng)
    mesh.box((-aside + 0.25, back - 0.4, 0.0), (0.5, 0.7, float(rng.uniform(0.6, 1.9))), reflectivity=WOOD)
    mesh.box((float(rng.uniform(-0.3, 0.3)), 0.5 * back, _HIGH_M - 0.35), (0.3, 0.3, 0.2), reflectivity=CLOTH)  # a lamp


def _bookcase(mesh: Mesh, rng: np.random.Generator) -> None:
    """1.2 m along y, its back at x = 0."""
    mesh.box((0.01, 0.0, 0.0), (0.02, 1.2, 1.9), reflectivity=WOOD)
    for side in (-0.6, 0.6):
        mesh.box((0.15, side, 0.0), (0.3, 0.03, 1.9), reflectivity=WOOD)
    for z in np.arange(0.1, 1.9, 0.35).tolist():
        mesh.box((0.15, 0.0, z), (0.3, 1.2, 0.02), reflectivity=WOOD)
        width, deep = float(rng.uniform(0.3, 1.0)), float(rng.uniform(0.12, 0.25))
        mesh.box((deep / 2, 0.0, z + 0.02), (deep, width, 0.24), reflectivity=CLOTH)


def _staircase(mesh: Mesh) -> None:
    """Between the floors, as wide as the hall, under the upper floor's ceiling."""
    for k in range(_STEPS):
        mesh.box(((k + 0.5) * _TREAD_M, 0.0, 0.0), (_TREAD_M, 2 * _HALL_M, (k + 1) * _RISE_M), reflectivity=WOOD)
    top = _UP_M + _HIGH_M
    for side in (-1.0, 1.0):
        mesh.slab((0.0, side * _HALL_M), (_STAIRS_M, side * _HALL_M), 0.0, (0.12, top), reflectivity=PLASTER)
        mesh.slab((_ABOVE_M, side * _HALL_M), (_ABOVE_M, 0.0), _UP_M, (0.12, _HIGH_M), reflectivity=PLASTER)
        mesh.slab((_BELOW_M, side * _HALL_M), (_BELOW_M, 0.0), 0.0, (0.12, _HIGH_M), reflectivity=STONE)
    mesh.slab((0.0, -_HALL_M), (0.0, _HALL_M), _HIGH_M, (0.12, _UP_M), reflectivity=PLASTER)
    corners = [[0.0, -_HALL_M, top], [_STAIRS_M, -_HALL_M, top], [_STAIRS_M, _HALL_M, top], [0.0, _HALL_M, top]]
    mesh.quads(np.array([corners]), reflectivity=PLASTER)
