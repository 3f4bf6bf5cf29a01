"""A hilly park: grass, winding paths, trees and bushes; a pond, a shelter, benches, boulders; hardly a plane in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place
from splitslam.sim.places.furniture import bench, bush, tree
from splitslam.sim.places.materials import GRASS, LEAVES, ROOF, STONE, WOOD
from splitslam.sim.places.ways import Waypoints

Array = NDArray[np.float64]

_SIZE_M = 150.0  # half the side of the square
_BENCHES = ((17.0, -13.5, 1.6), (29.0, -25.5, 0.1), (43.5, -12.0, -1.5), (-60.0, 62.0, 0.6), (70.0, 50.0, 2.2))
_WALKWAYS = ((38.0, -26.0, 46.0, -20.0), (22.0, -1.0, 38.0, 0.5), (17.5, -24.0, 15.5, -8.0), (-70.0, 50.0, -50.0, 68.0))
_CLEAR_M = 2.2  # beside a path nothing grows


def short_round() -> Waypoints:
    """A loop of about 60 m over the flank of the hill."""
    turn = np.arange(12) * 2 * np.pi / 12
    r = 9.5 + 1.3 * np.sin(2 * turn + 0.5) + 0.8 * np.cos(3 * turn)
    return tuple(
        (float(x), float(y)) for x, y in zip(30 + r * np.cos(turn) * 1.15, -12 + r * np.sin(turn), strict=True)
    )


def long_round() -> Waypoints:
    """A winding loop of about 720 m, up the hill and down again."""
    turn = np.arange(96) * 2 * np.pi / 96
    r = 88.0 + 16.0 * np.sin(3 * turn + 0.6) + 9.0 * np.cos(5 * turn)
    return _points(1.05 * r * np.cos(turn), 0.95 * r * np.sin(turn))


def _points(x: Array, y: Array) -> Waypoints:
    return tuple(zip(x.tolist(), y.tolist(), strict=True))


def height_m(x: Array, y: Array) -> Array:
    """Two hills and rolling ground; the ways follow it."""
    hills = 18.7 * np.exp(-((x - 95.0) ** 2 + (y - 20.0) ** 2) / 55.0**2)
    hills = hills + 7.0 * np.exp(-((x + 60.0) ** 2 + (y + 70.0) ** 2) / 30.0**2)
    rolling = 0.55 * np.sin(0.11 * x + 0.3) * np.cos(0.09 * y) + 0.22 * np.sin(0.31 * x - 0.23 * y)
    return hills + rolling - 0.4 * np.cos(0.05 * y)


def build_park(seed: int) -> Place:
    """300 m x 300 m. The seed plants it; hills and ways stay."""
    rng = np.random.default_rng([seed, 0x9A])
    mesh = Mesh()
    ways = np.concatenate([_dense(short_round()), _dense(long_round())])
    _ground(mesh, ways, rng)
    _woods(mesh, ways, rng)
    _shelter(mesh, 30.5, -13.0)
    for x, y, yaw in _BENCHES:
        with mesh.at((x, y, _z(x, y))):
            bench(mesh, 0.0, 0.0, yaw)
    triangles, reflectivity = mesh.arrays()
    return Place(triangles, reflectivity, height_m, _WALKWAYS)


def _z(x: float, y: float) -> float:
    return float(height_m(np.array([x]), np.array([y]))[0])


def _dense(way: Waypoints) -> Array:
    """Points (K, 2) every half metre or so of a closed way."""
    points = np.array([*way, way[0]])
    share = np.linspace(0.0, 1.0, 40, endpoint=False)[None, :, None]
    return (points[:-1, None] + share * np.diff(points, axis=0)[:, None]).reshape(-1, 2)


def _off(ways: Array, x: float, y: float) -> float:
    """Distance to the nearest way, m."""
    return float(np.sqrt(((ways - (x, y)) ** 2).sum(axis=1).min()))


def _ground(mesh: Mesh, ways: Array, rng: np.random.Generator) -> None:
    """Rough grass; the trodden ways are smoother."""
    from scipy.spatial import KDTree

    tree_of_ways = KDTree(ways)

    def rough(x: Array, y: Array) -> Array:
        off = tree_of_ways.query(np.stack([x.ravel(), y.ravel()], axis=1), distance_upper_bound=4.0)[0].reshape(x.shape)
        grass = np.clip((np.minimum(off, 4.0) - 0.8) / 1.2, 0.15, 1.0)
        return height_m(x, y) + grass * (rng.normal(0.0, 0.045, x.shape) + 0.05 * np.sin(1.3 * x + 0.7 * y))

    mesh.ground((-_SIZE_M, -_SIZE_M), (_SIZE_M, _SIZE_M), 0.6, rough, reflectivity=GRASS)


def _woods(mesh: Mesh, ways: Array, rng: np.random.Generator) -> None:
    """Trees, denser in some parts than in others; bushes under them and along the ways; boulders and tufts."""
    spots = rng.uniform(-_SIZE_M + 4, _SIZE_M - 4, (900, 2))
    dense = np.sin(0.05 * spots[:, 0] + 1.0) * np.cos(0.06 * spots[:, 1]) + 0.3 * rng.random(900) > 0.0
    near = np.hypot(spots[:, 0] - 30.0, spots[:, 1] + 12.0) < 45.0
    for x, y in spots[dense | near]:
        off = _off(ways, x, y)
        if off > _CLEAR_M:
            with mesh.at((float(x), float(y), _z(x, y))):
                _park_tree(mesh, rng, fineness=3 if off < 12.0 else 2)
    for _ in range(420):
        x, y = ways[rng.integers(len(ways))] + rng.normal(0.0, 5.0, 2)
        size_m = float(rng.uniform(0.5, 1.2))
        if _off(ways, x, y) > 0.8 + 2.0 * size_m:
            with mesh.at((float(x), float(y), _z(x, y))):
                bush(mesh, 0.0, 0.0, size_m, rng)
    for _ in range(160):
        x, y = ways[rng.integers(len(ways))] + rng.normal(0.0, 6.0, 2)
        if _off(ways, x, y) > _CLEAR_M - 0.6:
            r = float(rng.uniform(0.2, 0.6))
            with mesh.at((float(x), float(y), _z(x, y))):
                mesh.blob((0.0, 0.0, 0.2 * r), (r, 0.8 * r, 0.7 * r), rng, fineness=2, reflectivity=STONE)


def _park_tree(mesh: Mesh, rng: np.random.Generator, fineness: int) -> None:
    """A broad-leaved tree, or (one in four) a conifer."""
    if rng.random() > 0.25:
        tree(mesh, (0.0, 0.0), float(rng.uniform(5.0, 13.0)), rng)
        return
    height = float(rng.uniform(7.0, 14.0))
    mesh.frustum((0.0, 0.0, -0.4), (0.2, 0.08), height, 8, reflectivity=WOOD)
    for k in range(5):
        r = 0.17 * height * (1.0 - k / 6.0)
        mesh.blob((0.0, 0.0, height * (0.22 + 0.16 * k)), (r, r, 0.5 * r), rng, holes=0.35, fineness=fineness,
                  reflectivity=LEAVES)  # fmt: skip


def _shelter(mesh: Mesh, x: float, y: float) -> None:
    """Four posts and a roof, the only right angles."""
    with mesh.at((x, y, _z(x, y)), 0.4):
        for px in (-1.8, 1.8):
            for py in (-1.3, 1.3):
                mesh.frustum((px, py, -0.6), (0.1, 0.1), 3.1, 8, reflectivity=WOOD)
        mesh.gable((0.0, 0.0, 2.4), (4.6, 3.6, 1.2), reflectivity=ROOF)
        mesh.box((0.0, 0.0, -0.5), (1.6, 0.8, 1.2), reflectivity=WOOD)
