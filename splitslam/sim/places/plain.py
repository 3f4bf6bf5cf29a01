"""Open country: a road between fields, a post every 50 m, a tree now and then, one barn; mostly there is ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place
from splitslam.sim.places.furniture import bush, road_sign, tree
from splitslam.sim.places.materials import ASPHALT, BRICK, GRASS, PLASTER, ROOF, SIGN, WOOD
from splitslam.sim.places.ways import Waypoints

Array = NDArray[np.float64]

_LENGTH_M = 900.0
_FIELD_M = 70.0  # from the road, either way
_ROAD_M = 3.5  # half its width
_ROUGH_M = 0.04  # clods and grass


def along_the_road() -> Waypoints:
    """In the right-hand lane."""
    x = np.arange(0.0, _LENGTH_M, 15.0)
    return tuple(zip(x.tolist(), (_middle(x) - 1.75).tolist(), strict=True))


def build_plain(seed: int) -> Place:
    """The road stays; the seed sows fields, trees and bushes."""
    rng = np.random.default_rng([seed, 0x91])
    mesh = Mesh()
    mesh.ground((-110.0, -_FIELD_M - 30), (_LENGTH_M + 110, _FIELD_M + 30), 1.0, _fields(rng), reflectivity=GRASS)
    _road(mesh)
    for x in np.arange(-100.0, _LENGTH_M + 100, 50.0):
        for side in (-1.0, 1.0):
            mesh.box(_beside(x, side * (_ROAD_M + 0.8)), (0.12, 0.12, 1.0), reflectivity=SIGN)
    for x in np.arange(-60.0, _LENGTH_M + 100, 80.0):
        mesh.frustum(_beside(x, 19.0), (0.16, 0.11), 9.0, 10, reflectivity=WOOD)  # carries a wire
    at = -80.0
    while at < _LENGTH_M + 80.0:
        with mesh.at(_beside(at, float(rng.choice((-1.0, 1.0)) * rng.uniform(9.0, 28.0)))):
            tree(mesh, (0.0, 0.0), float(rng.uniform(6.0, 11.0)), rng)
        at += float(rng.uniform(30.0, 110.0))
    for x in np.arange(560.0, 640.0, 2.2):
        with mesh.at(_beside(x, -9.0 + float(rng.normal(0.0, 0.3)))):
            bush(mesh, 0.0, 0.0, float(rng.uniform(0.7, 1.1)), rng)
    with mesh.at(_beside(380.0, 34.0), 0.3):
        mesh.box((0.0, 0.0, -0.5), (24.0, 13.0, 5.0), reflectivity=BRICK)
        mesh.gable((0.0, 0.0, 4.5), (25.0, 14.0, 4.0), reflectivity=ROOF)
        mesh.box((-6.0, -6.6, 0.0), (4.0, 0.2, 3.6), reflectivity=PLASTER)
    for x in (210.0, 705.0):
        with mesh.at(_beside(x, -_ROAD_M - 1.6), -np.pi / 2):
            road_sign(mesh, rng)
    triangles, reflectivity = mesh.arrays()
    return Place(triangles, reflectivity, _lie, ((40.0, 12.0, 80.0, 12.0),))


def _middle(x: Array) -> Array:
    """y of the road's middle."""
    return 26.0 * np.sin(x / 210.0)


def _lie(x: Array, y: Array) -> Array:
    """Height of the land: long waves."""
    return 1.6 * np.sin(x / 95.0) + 0.7 * np.cos(y / 60.0 + x / 140.0) + 0.02 * np.sin(x / 4.0)


def _fields(rng: np.random.Generator):
    def height_m(x: Array, y: Array) -> Array:
        aside = np.abs(y - _middle(x)) - _ROAD_M
        ditch = -0.5 * np.exp(-(((aside - 2.2) / 0.8) ** 2))
        under = np.where(aside < 1.0, -0.15, 0.0)  # the road lies on it
        return _lie(x, y) + ditch + under + np.where(aside > 1.0, rng.normal(0.0, _ROUGH_M, x.shape), 0.0)

    return height_m


def _road(mesh: Mesh) -> None:
    x = np.arange(-110.0, _LENGTH_M + 110.0, 2.0)
    right, left = (np.column_stack([x, _middle(x) + side, _lie(x, _middle(x) + side)]) for side in (-_ROAD_M, _ROAD_M))
    mesh.quads(np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1), reflectivity=ASPHALT)


def _beside(x: float, aside_m: float) -> tuple[float, float, float]:
    """On the ground, so far left of the road's middle."""
    y = float(_middle(np.array(x))) + aside_m
    return float(x), y, float(_lie(np.array(x), np.array(y)))
