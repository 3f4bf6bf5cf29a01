"""A town: streets round one block and on beyond it, rows of houses, parked cars, kerbs, lamps, trees, signs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place
from splitslam.sim.places.buildings import house_in_row, random_house
from splitslam.sim.places.furniture import bollard, car, lamp, road_sign, tree, van
from splitslam.sim.places.materials import ASPHALT, BRICK, PAVING, STONE
from splitslam.sim.places.ways import Waypoints, rounded

Array = NDArray[np.float64]

_X = (0.0, 104.0)  # middles of the streets that go along y
_Y = (0.0, 66.0)  # and along x
_ENDS = (-62.0, 166.0, -62.0, 128.0)
_ROAD_M, _FRONT_M = 5.4, 8.2  # from a street's middle to its kerb and to the houses
_KERB_M = 0.13


def round_the_block() -> Waypoints:
    """In the right-hand lane, counter-clockwise, from the middle of the southern street."""
    lane, (x0, x1), (y0, y1) = 1.7, _X, _Y
    loop = rounded(((x0 - lane, y0 - lane), (x1 + lane, y0 - lane), (x1 + lane, y1 + lane), (x0 - lane, y1 + lane)),
                   9.5, 4.0, closed=True)  # fmt: skip
    start = min(range(len(loop)), key=lambda k: (loop[k][0] - 15.0) ** 2 + (loop[k][1] + lane) ** 2)
    return loop[start:] + loop[:start]


def build_street(seed: int) -> Place:
    """The seed moves houses, cars and trees; the streets stay."""
    rng = np.random.default_rng([seed, 0x57])
    mesh = Mesh()
    x0, x1, y0, y1 = _ENDS
    mesh.ground((x0 - 14, y0 - 14), (x1 + 14, y1 + 14), 2.0, _road, reflectivity=ASPHALT)
    xs = ((x0, _X[0]), _X, (_X[1], x1))
    ys = ((y0, _Y[0]), _Y, (_Y[1], y1))
    for a in xs:
        for b in ys:
            _block(mesh, a, b, rng)
    for k in (0, 1):
        _along(mesh, (x0, _Y[k]), (x1, _Y[k]), _X, rng)
        _along(mesh, (_X[k], y0), (_X[k], y1), _Y, rng)
        for x, y, yaw in ((_X[k] - 9, y0 - 8, 0.0), (_X[k] + 9, y1 + 8, np.pi)):  # what closes each street
            _house(mesh, x, y, yaw + np.pi, 18.0, rng)
        for x, y, yaw in ((x0 - 8, _Y[k] - 9, np.pi / 2), (x1 + 8, _Y[k] + 9, -np.pi / 2)):
            _house(mesh, x, y, yaw, 18.0, rng)
    triangles, reflectivity = mesh.arrays()
    pavement = 7.2
    walkways = ((20.0, -pavement, 60.0, -pavement), (96.8, 12.0, 96.8, 50.0), (90.0, 58.8, 45.0, 58.8),
                (-pavement, 52.0, -pavement, 15.0), (52.0, pavement, 92.0, pavement), (111.2, 48.0, 111.2, 15.0),
                (50.0, 73.2, 90.0, 73.2), (pavement, 18.0, pavement, 52.0))  # fmt: skip
    return Place(triangles, reflectivity, _road, walkways)


def _road(x: Array, y: Array) -> Array:
    """Height of the carriageway: a town on a slight slope."""
    return 0.9 * np.sin(x / 55.0 + 0.3) + 0.6 * np.cos(y / 40.0) + 0.01 * x + 0.02 * np.sin(0.7 * x) * np.cos(0.6 * y)


def _z(x: float, y: float, lift_m: float = _KERB_M) -> float:
    return float(_road(np.array([x]), np.array([y]))[0]) + lift_m


def _block(mesh: Mesh, x: tuple[float, float], y: tuple[float, float], rng: np.random.Generator) -> None:
    """Pavement and houses on those sides of a block that look on a street."""
    (west, east), (south, north) = x, y
    corners = [(west, south), (east, south), (east, north), (west, north)]
    streets = [south in _Y, east in _X, north in _Y, west in _X]
    for k in range(4):
        if not streets[k]:
            continue
        a, b = np.array(corners[k]), np.array(corners[(k + 1) % 4])
        along = (b - a) / np.linalg.norm(b - a)
        inward = np.array([-along[1], along[0]])
        before, after = (_FRONT_M if streets[(k + side) % 4] else 0.0 for side in (-1, 1))
        kerb = [_ROAD_M if reach else 0.0 for reach in (before, after)]
        line = np.linspace(a + kerb[0] * along, b - kerb[1] * along, max(2, round(float(np.linalg.norm(b - a)) / 5)))
        _pavement(mesh, line + _ROAD_M * inward, line + (_FRONT_M + 1.0) * inward)
        _row(mesh, a + before * along + _FRONT_M * inward, b - after * along + _FRONT_M * inward, rng)


def _pavement(mesh: Mesh, kerb: Array, wall: Array) -> None:
    edges = ((kerb, -0.1), (kerb, _KERB_M), (wall, _KERB_M))
    low, high, back = (np.column_stack([line, _road(*line.T) + lift]) for line, lift in edges)
    for a, b, reflectivity in ((low, high, STONE), (high, back, PAVING)):
        mesh.quads(np.stack([a[:-1], a[1:], b[1:], b[:-1]], axis=1), reflectivity=reflectivity)


def _row(mesh: Mesh, start: Array, end: Array, rng: np.random.Generator) -> None:
    """Houses side by side, now and then a yard with a wall and a tree."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    yaw = float(np.arctan2(along[1], along[0]))
    at = 0.0
    while length - at > 7.0:
        width = min(float(rng.uniform(9.0, 17.0)), length - at)
        if length - at - width < 7.0:
            width = length - at
        x, y = start + at * along
        if rng.random() < 0.1 and 9.0 < width < 14.0:
            _yard(mesh, float(x), float(y), yaw, width, rng)
        else:
            _house(mesh, float(x), float(y), yaw, width, rng)
        at += width


def _house(mesh: Mesh, x: float, y: float, yaw: float, width_m: float, rng: np.random.Generator) -> None:
    setback = float(rng.uniform(0.0, 0.5))
    middle = (x + width_m / 2 * np.cos(yaw), y + width_m / 2 * np.sin(yaw))
    with mesh.at((x - setback * np.sin(yaw), y + setback * np.cos(yaw), _z(*middle)), yaw):
        house_in_row(mesh, random_house(width_m, rng), rng)


def _yard(mesh: Mesh, x: float, y: float, yaw: float, width_m: float, rng: np.random.Generator) -> None:
    with mesh.at((x, y, _z(x, y)), yaw):
        mesh.slab((0.0, 0.3), (width_m, 0.3), -0.6, (0.3, 2.1), reflectivity=BRICK)
        mesh.slab((0.0, 12.0), (width_m, 12.0), -0.6, (0.3, 6.1), reflectivity=BRICK)
        tree(mesh, (width_m / 2, 4.0), float(rng.uniform(6.0, 8.0)), rng)


def _along(mesh: Mesh, a: tuple[float, float], b: tuple[float, float], crossings: tuple[float, float],
           rng: np.random.Generator) -> None:  # fmt: skip
    """What stands along both kerbs of one street: parked cars and vans, lamps, trees, signs, bollards."""
    start, end = np.array(a), np.array(b)
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    yaw = float(np.arctan2(along[1], along[0]))
    junctions = [c - float(start @ along) for c in crossings]
    green = rng.random() < 0.6

    def free(s: float, margin_m: float) -> bool:
        return all(abs(s - j) > _ROAD_M + margin_m for j in junctions)

    with mesh.at((a[0], a[1], 0.0), yaw):
        for side in (-1.0, 1.0):
            facing = 0.0 if side < 0 else np.pi
            s = float(rng.uniform(3.0, 8.0))
            while s < length - 4:
                x, y = start + s * along
                if free(s, 7.0) and rng.random() < 0.75:
                    with mesh.at((s, side * (_ROAD_M - 1.05 + rng.normal(0, 0.06)), _z(x, y, 0.0)), facing):
                        park = van if rng.random() < 0.15 else car
                        park(mesh, 0.0, 0.0, float(rng.normal(0.0, 0.02)), rng)
                s += float(rng.uniform(5.6, 8.5))
            for k, s in enumerate(np.arange(6.0 if side < 0 else 18.0, length, 24.0)):
                x, y = start + s * along
                if not free(float(s), 1.0):
                    continue
                with mesh.at((float(s), side * (_ROAD_M + 0.5), _z(x, y)), 0.0 if side > 0 else np.pi):
                    lamp(mesh, 0.0, 0.0, 7.0) if k % 2 else road_sign(mesh, rng)
            for s in np.arange(11.0, length, 10.5):
                x, y = start + s * along
                if green and free(float(s), 4.0) and rng.random() < 0.8:
                    with mesh.at((float(s), side * (_ROAD_M + 0.75), _z(x, y))):
                        tree(mesh, (0.0, 0.0), float(rng.uniform(5.0, 8.0)), rng)
            for junction in junctions:
                for s in (junction - 6.6, junction - 8.0, junction + 6.6, junction + 8.0):
                    x, y = start + s * along
                    with mesh.at((s, side * (_ROAD_M + 0.35), _z(x, y))):
                        bollard(mesh)
