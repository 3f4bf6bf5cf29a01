"""A university quarter: blocks of buildings, lawns and courts, with ways between and round them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place
from splitslam.sim.places.buildings import building
from splitslam.sim.places.furniture import bench, bush, car, lamp, road_sign, tree
from splitslam.sim.places.materials import BRICK, CONCRETE, METAL, PAVING, PLASTER, STONE
from splitslam.sim.places.ways import Waypoints, rounded

Array = NDArray[np.float64]

_X = ((-90.0, -51.0), (-41.0, -5.0), (5.0, 42.0), (52.0, 101.0))  # blocks
_Y = ((-52.0, -5.0), (5.0, 52.0))
_RING = (-94.5, 106.0, -56.5, 56.5)  # middle of the way round all of them


def walking_way() -> Waypoints:
    """Round the two middle blocks of the northern half, about 290 m, where the ground is flat."""
    return rounded(((-46.0, 0.0), (47.0, 0.0), (47.0, 56.5), (-46.0, 56.5)), 3.0, 3.0, closed=True)


def campus_way() -> Waypoints:
    """A figure of eight through the whole quarter, about 720 m, up the slope in the east."""
    x0, x1, y0, y1 = _RING
    corners = ((x0, y0), (0.0, y0), (0.0, y1), (x1, y1), (x1, y0), (47.0, y0), (47.0, 0.0), (x0, 0.0))
    return rounded(corners, 3.0, 3.0, closed=True)


def ground_m(x: Array, y: Array) -> Array:
    """Flat, and a gentle slope in the east."""
    slope = np.clip((x - 48.0) / 58.0, 0.0, 1.0)
    rolling = 0.113 * np.sin(0.045 * x + 0.4) * np.cos(0.055 * y) + 0.03 * np.sin(0.11 * x - 0.09 * y)
    return rolling + 0.73 * slope**2 * (3.0 - 2.0 * slope)


def build_quarter(seed: int) -> Place:
    """210 m x 130 m. The seed moves buildings, trees and benches; the ways stay."""
    rng = np.random.default_rng([seed, 0x9B])
    mesh = Mesh()
    x0, x1, y0, y1 = _RING

    def rough(x: Array, y: Array) -> Array:
        lawn = np.zeros_like(x)
        for a, b in _X:
            for c, d in _Y:
                lawn[(x > a + 1) & (x < b - 1) & (y > c + 1) & (y < d - 1)] = 1.0
        return ground_m(x, y) + lawn * (0.06 + rng.normal(0.0, 0.03, x.shape))

    mesh.ground((x0 - 45, y0 - 45), (x1 + 45, y1 + 45), 1.0, rough, reflectivity=PAVING)
    for a in _X:
        for b in _Y:
            _block(mesh, a, b, rng)
    _rim(mesh, rng)
    for y in (0.0, y0, y1):
        _along_way(mesh, (x0, y), (x1, y), rng)
    for x in (-46.0, 0.0, 47.0, x0, x1):
        _along_way(mesh, (x, y0), (x, y1), rng)
    triangles, reflectivity = mesh.arrays()
    walkways = ((-40.0, 2.2, 40.0, 2.2), (44.9, 8.0, 44.9, 50.0), (40.0, 58.6, -40.0, 58.6), (-48.2, 50.0, -48.2, 6.0),
                (2.1, -50.0, 2.1, -6.0), (103.6, -40.0, 103.6, 40.0))  # fmt: skip
    return Place(triangles, reflectivity, ground_m, walkways)


def _z(x: float, y: float) -> float:
    return float(ground_m(np.array([x]), np.array([y]))[0])


def _house(mesh: Mesh, centre: tuple[float, float], size: tuple[float, float], rng: np.random.Generator) -> None:
    storeys = int(rng.integers(2, 5))
    height = storeys * float(rng.uniform(3.0, 3.6))
    material, door = int(rng.choice([BRICK, PLASTER, CONCRETE])), float(rng.uniform(-0.35, 0.35))
    with mesh.at((*centre, _z(*centre))):
        building(mesh, (0.0, 0.0), size, height, storeys=storeys, reflectivity=material, door_at=door)


def _block(mesh: Mesh, x: tuple[float, float], y: tuple[float, float], rng: np.random.Generator) -> None:
    """A building along one side, a second one across or a lawn, and a court between them."""
    (x0, x1), (y0, y1) = x, y
    width, depth = x1 - x0, y1 - y0
    north = rng.random() < 0.5
    long_depth = float(rng.uniform(11.0, 15.0))
    set_back = float(rng.uniform(2.0, 5.0))
    cy = y1 - set_back - long_depth / 2 if north else y0 + set_back + long_depth / 2
    _house(mesh, ((x0 + x1) / 2, cy), (width - float(rng.uniform(4.0, 9.0)), long_depth), rng)
    free = (y0 + 3.0, y1 - set_back - long_depth - 5.0) if north else (y0 + set_back + long_depth + 5.0, y1 - 3.0)
    if rng.random() < 0.7:
        side = float(rng.uniform(9.0, 13.0))
        cx = x0 + 3.0 + side / 2 if rng.random() < 0.5 else x1 - 3.0 - side / 2
        _house(mesh, (cx, sum(free) / 2), (side, free[1] - free[0] - 1.0), rng)
        free_x = (cx + side / 2 + 2.0, x1 - 2.0) if cx < (x0 + x1) / 2 else (x0 + 2.0, cx - side / 2 - 2.0)
    else:
        free_x = (x0 + 2.0, x1 - 2.0)
    for _ in range(int((free_x[1] - free_x[0]) * depth / 90.0)):
        tx, ty = rng.uniform(*free_x), rng.uniform(*free)
        with mesh.at((float(tx), float(ty), _z(tx, ty))):
            tree(mesh, (0.0, 0.0), float(rng.uniform(4.5, 10.0)), rng)
    for _ in range(10):
        bx, by = rng.uniform(*free_x), float(rng.choice(free)) + rng.normal(0.0, 0.3)
        with mesh.at((float(bx), float(by), _z(bx, by))):
            bush(mesh, 0.0, 0.0, float(rng.uniform(0.5, 0.9)), rng)


def _rim(mesh: Mesh, rng: np.random.Generator) -> None:
    """What stands outside the outermost way: buildings, walls with trees behind them, parked cars."""
    x0, x1, y0, y1 = _RING
    for y, out in ((y0, -1.0), (y1, 1.0)):
        x = x0 - 5.0
        while x < x1:
            length = float(rng.uniform(16.0, 34.0))
            middle = (x + length / 2, y + out * 13.0)
            if rng.random() < 0.6:
                _house(mesh, middle, (length - 3.0, 12.0), rng)
            else:
                _garden(mesh, (x, y + out * 5.0), (x + length - 2.0, y + out * 5.0), out, rng)
            x += length + float(rng.uniform(1.0, 6.0))
    for x, out in ((x0, -1.0), (x1, 1.0)):
        y = y0 + 2.0
        while y < y1 - 8.0:
            length = min(float(rng.uniform(16.0, 30.0)), y1 - y)
            _house(mesh, (x + out * 13.0, y + length / 2), (12.0, length - 2.0), rng)
            y += length + float(rng.uniform(2.0, 9.0))
        for y in np.arange(y0 + 6.0, y1 - 6.0, 5.8):
            if rng.random() < 0.5:
                with mesh.at((x + out * 4.6, float(y), _z(x, float(y)))):
                    car(mesh, 0.0, 0.0, np.pi / 2 + float(rng.normal(0, 0.03)), rng)


def _garden(mesh: Mesh, a: tuple[float, float], b: tuple[float, float], out: float, rng: np.random.Generator) -> None:
    z = min(_z(*a), _z(*b)) - 0.3
    mesh.slab(a, b, z, (0.3, 1.5), reflectivity=STONE)
    for x in np.linspace(a[0], b[0], max(2, round((b[0] - a[0]) / 3.0))).tolist():
        mesh.box((x, a[1], z), (0.5, 0.5, 1.9), reflectivity=BRICK)
    for _ in range(5):
        x, y = float(rng.uniform(a[0], b[0])), a[1] + out * float(rng.uniform(2.5, 14.0))
        with mesh.at((x, y, _z(x, y))):
            tree(mesh, (0.0, 0.0), float(rng.uniform(6.0, 11.0)), rng)


def _along_way(mesh: Mesh, a: tuple[float, float], b: tuple[float, float], rng: np.random.Generator) -> None:
    """Lamps, benches, signs, bins and bicycle stands 3 m beside the middle of a way."""
    start, end = np.array(a), np.array(b)
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    aside = np.array([-along[1], along[0]])
    yaw = float(np.arctan2(along[1], along[0]))
    for s in np.arange(7.0, length - 5.0, 9.0):
        side = float(rng.choice([-1.0, 1.0]))
        x, y = start + (s + rng.normal(0.0, 0.8)) * along + side * 3.4 * aside
        if _on_a_way(float(x), float(y)):
            continue
        with mesh.at((float(x), float(y), _z(x, y)), yaw if side < 0 else yaw + np.pi):
            what = rng.integers(0, 5)
            if what <= 1:
                lamp(mesh, 0.0, 0.0, 4.5)
            elif what == 2:
                bench(mesh, 0.0, 0.0, np.pi)
            elif what == 3:
                road_sign(mesh, rng)
            else:
                mesh.frustum((0.0, 0.0, -0.2), (0.3, 0.28), 1.2, reflectivity=METAL)


def _on_a_way(x: float, y: float) -> bool:
    """True where someone would walk into it."""
    x0, x1, y0, y1 = _RING
    return any(abs(x - m) < 2.5 for m in (-46.0, 0.0, 47.0, x0, x1)) or any(abs(y - m) < 2.5 for m in (0.0, y0, y1))
