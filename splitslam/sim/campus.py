"""A campus yard: a pavilion in the middle, buildings on three sides, a street in the south, a green in the west."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place

Array = NDArray[np.float64]

_GRASS, _PAVING, _STONE, _PLASTER, _BRICK, _CONCRETE = 45, 22, 60, 75, 40, 50
_GLASS, _WOOD, _METAL, _LEAVES, _ROOF, _SIGN, _RUBBER = 8, 35, 55, 50, 18, 220, 6


def build_campus(seed: int) -> Place:
    """120 m x 120 m. The seed moves trees, cars, benches and the roughness of the grass; the buildings stay."""
    rng = np.random.default_rng([seed, 0xCA])
    mesh = Mesh()
    mesh.ground(60.0, 1.0, _rough_ground(rng), reflectivity=_PAVING)
    _pavilion(mesh)
    _building(mesh, (-6.0, 21.0), (46.0, 11.0), 10.5, storeys=3, reflectivity=_BRICK, door_at=0.2)
    _building(mesh, (27.0, 1.0), (12.0, 22.0), 7.5, storeys=2, reflectivity=_PLASTER, door_at=-0.25)
    _building(mesh, (-38.0, -4.0), (9.0, 20.0), 5.0, storeys=1, reflectivity=_CONCRETE, door_at=0.1)
    _building(mesh, (12.0, -33.0), (18.0, 9.0), 8.0, storeys=2, reflectivity=_PLASTER, door_at=0.3)
    _building(mesh, (-14.0, -34.0), (22.0, 10.0), 6.5, storeys=2, reflectivity=_BRICK, door_at=-0.1)
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
    mesh.box((0.0, 0.0, -0.3), (7.0, 4.4, 0.45), reflectivity=_STONE)
    mesh.box((0.3, 0.3, 0.1), (4.6, 2.6, 2.9), reflectivity=_PLASTER)
    mesh.box((-0.9, -1.02, 0.15), (1.0, 0.12, 2.1), reflectivity=_WOOD)
    for x in (1.0, 2.0):
        mesh.box((x, -1.04, 1.1), (0.8, 0.16, 1.0), reflectivity=_GLASS)
    mesh.box((0.3, 1.66, 0.9), (2.8, 0.3, 1.2), reflectivity=_WOOD)
    for x in (-3.1, -1.05, 1.05, 3.1):
        for y in (-1.9, 1.9):
            mesh.frustum((x, y, 0.1), (0.16, 0.13), 2.8, reflectivity=_STONE)
    mesh.box((0.0, 0.0, 2.9), (7.2, 4.6, 0.25), reflectivity=_STONE)
    mesh.gable((0.0, 0.0, 3.15), (7.4, 4.9, 1.3), reflectivity=_ROOF)
    mesh.box((-3.9, 0.6, -0.2), (0.6, 1.6, 1.0), reflectivity=_METAL)


def _building(mesh: Mesh, centre: tuple[float, float], size: tuple[float, float], height_m: float, *, storeys: int,
              reflectivity: int, door_at: float) -> None:  # fmt: skip
    """A box with a base course, pilasters, window frames and sills, doors with a canopy, eaves and a roof."""
    (cx, cy), (length, width) = centre, size
    mesh.box((cx, cy, -0.5), (length, width, height_m + 0.5), reflectivity=reflectivity)
    mesh.box((cx, cy, -0.5), (length + 0.16, width + 0.16, 1.0), reflectivity=_STONE)
    mesh.box((cx, cy, height_m), (length + 1.0, width + 1.0, 0.25), reflectivity=_STONE)
    mesh.gable((cx, cy, height_m + 0.25), (length + 0.8, width + 0.8, min(3.0, 0.25 * width)), reflectivity=_ROOF)
    for side in range(4):
        along, out = (length, width) if side % 2 == 0 else (width, length)
        turn = side * np.pi / 2
        c, s = np.cos(turn), np.sin(turn)

        def part(at_m: float, depth_m: float, z_m: float, size_m: tuple[float, float], material: int,
                 frame: tuple[float, float, float, float] = (c, s, out, turn)) -> None:  # fmt: skip
            """A box proud of the wall by depth_m, `at_m` along it."""
            c, s, out, turn = frame
            x, y = at_m, -out / 2
            mesh.box((cx + c * x - s * y, cy + s * x + c * y, z_m), (size_m[0], 2 * depth_m, size_m[1]), turn,
                     reflectivity=material)  # fmt: skip

        bays = max(2, round(along / 3.4))
        storey_m = height_m / storeys
        for k in range(bays + 1):
            part((k / bays - 0.5) * (along - 0.5), 0.22, 0.0, (0.45, height_m), reflectivity)
        door = int((0.5 + door_at) * bays)
        for k in range(bays):
            at = ((k + 0.5) / bays - 0.5) * (along - 0.5)
            for floor in range(storeys):
                z = floor * storey_m
                if k == door and floor == 0:
                    part(at, 0.14, 0.0, (1.7, 2.4), _WOOD)
                    part(at, 0.9, 2.55, (2.4, 0.14), _METAL)
                    part(at, 0.75, 0.0, (2.2, 0.15), _STONE)
                    continue
                part(at, 0.06, z + 1.0, (1.5, 0.55 * storey_m), _GLASS)
                part(at, 0.18, z + 0.9, (1.8, 0.1), _STONE)
                part(at, 0.12, z + 1.0 + 0.55 * storey_m, (1.7, 0.12), _STONE)


def _south_wall_and_street(mesh: Mesh, rng: np.random.Generator) -> None:
    for start, end in ((-30.0, -5.5), (-1.5, 21.0)):
        mesh.slab((start, -14.0), (end, -14.0), -0.3, (0.35, 2.0), reflectivity=_BRICK)
        mesh.slab((start, -14.0), (end, -14.0), 1.7, (0.5, 0.12), reflectivity=_STONE)
        for x in np.arange(start, end + 0.1, (end - start) / 6):
            mesh.box((float(x), -14.0, -0.3), (0.55, 0.55, 2.4), reflectivity=_BRICK)
    for x in (-5.5, -1.5):
        mesh.frustum((x, -14.0, 2.1), (0.3, 0.05), 0.6, reflectivity=_STONE)
    mesh.slab((21.0, -14.0), (21.0, -10.5), -0.3, (0.35, 2.0), reflectivity=_BRICK)
    for y in (-17.0, -25.5):
        mesh.slab((-58.0, y), (58.0, y), -0.3, (0.3, 0.42), reflectivity=_STONE)
    for x in (-40.0, -20.0, 0.5, 20.0, 40.0):
        _lamp(mesh, x, -16.2, 6.5)
    x = -45.0
    while x < 45.0:
        _car(mesh, x, -18.3 + rng.normal(0.0, 0.08), rng.normal(0.0, 0.02), rng)
        x += rng.uniform(5.2, 12.0)
    for x in (-24.0, 2.0, 26.0):
        _tree(mesh, (x + rng.normal(0, 0.5), -26.8), rng.uniform(6, 8), rng)


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
        _tree(mesh, (x + rng.normal(0, 0.4), y + rng.normal(0, 0.4)), rng.uniform(4.5, 9.0), rng)
    for k in range(9):
        mesh.blob((-14.6 + rng.normal(0, 0.1), -7.5 + 1.2 * k, 0.45), (0.55, 0.75, 0.6), rng, reflectivity=_LEAVES)
    for k in range(13):  # a fence behind the green
        y = -13.0 + 2.4 * k
        mesh.frustum((-33.0, y, -0.3), (0.05, 0.05), 1.7, 6, reflectivity=_METAL)
    for z in (0.3, 0.8, 1.3):
        mesh.slab((-33.0, -13.0), (-33.0, 15.8), z, (0.05, 0.06), reflectivity=_METAL)


def _yard(mesh: Mesh, rng: np.random.Generator) -> None:
    for y in (-12.5, 14.2):
        mesh.slab((-13.5, y), (20.0, y), -0.3, (0.25, 0.45), reflectivity=_STONE)
    for x, y in ((11.8, -11.0), (-11.0, -11.4), (12.4, 12.6), (-11.3, 12.2), (19.4, 3.0)):
        _lamp(mesh, x, y, 4.2)
    for x, y in ((17.5, -8.0), (16.8, 9.5), (4.5, 12.9), (-6.5, 13.1)):
        _tree(mesh, (x, y), rng.uniform(4.0, 6.0), rng)
        mesh.frustum((x, y, -0.3), (0.95, 0.9), 0.75, 8, reflectivity=_STONE)
    for x, y, yaw in ((-1.5, 12.4, 0.0), (9.8, 12.7, 0.0), (18.6, -2.5, np.pi / 2), (-11.8, -2.0, np.pi / 2)):
        _bench(mesh, x + rng.normal(0, 0.2), y, yaw + rng.normal(0, 0.05))
    for k in range(6):  # bicycle stands
        mesh.slab((6.0 + 0.9 * k, -12.0), (6.0 + 0.9 * k, -11.0), 0.75, (0.06, 0.06), reflectivity=_METAL)
        for y in (-12.0, -11.0):
            mesh.frustum((6.0 + 0.9 * k, y, -0.2), (0.03, 0.03), 1.0, 6, reflectivity=_METAL)
    for x, y in ((12.6, 3.4), (-10.4, 9.0)):
        mesh.frustum((x, y, -0.2), (0.03, 0.03), 2.6, 6, reflectivity=_METAL)
        mesh.box((x + 0.04, y, 1.9), (0.02, 0.6, 0.45), 0.4, reflectivity=_SIGN)
    mesh.frustum((-9.6, -10.3, -0.2), (0.3, 0.28), 1.2, reflectivity=_METAL)
    _car(mesh, 15.0, -10.6, 1.45, rng)
    _car(mesh, 17.9, -10.9, 1.6, rng)


def _lamp(mesh: Mesh, x: float, y: float, height_m: float) -> None:
    mesh.frustum((x, y, -0.3), (0.16, 0.16), 0.9, reflectivity=_CONCRETE)
    mesh.frustum((x, y, 0.5), (0.08, 0.05), height_m - 0.5, 8, reflectivity=_METAL)
    mesh.box((x, y + 0.4, height_m - 0.1), (0.25, 1.0, 0.12), reflectivity=_METAL)


def _bench(mesh: Mesh, x: float, y: float, yaw: float) -> None:
    c, s = np.cos(yaw), np.sin(yaw)
    mesh.box((x, y, 0.4), (1.7, 0.45, 0.07), yaw, reflectivity=_WOOD)
    mesh.box((x - 0.22 * s, y + 0.22 * c, 0.47), (1.7, 0.06, 0.4), yaw, reflectivity=_WOOD)
    for d in (-0.65, 0.65):
        mesh.box((x + d * c, y + d * s, -0.2), (0.12, 0.4, 0.62), yaw, reflectivity=_CONCRETE)


def _car(mesh: Mesh, x: float, y: float, yaw: float, rng: np.random.Generator) -> None:
    """Body, cabin, wheels; every car a little different."""
    c, s = np.cos(yaw), np.sin(yaw)
    length, height = rng.uniform(3.9, 4.7), rng.uniform(1.4, 1.65)
    paint = int(rng.choice([12, 35, 70, 90]))
    mesh.box((x, y, 0.28), (length, 1.78, 0.5 * height - 0.1), yaw, reflectivity=paint)
    back = rng.uniform(0.1, 0.5)
    mesh.box((x - back * c, y - back * s, 0.5 * height), (0.58 * length, 1.6, 0.4 * height), yaw, reflectivity=_GLASS)
    mesh.box((x - back * c, y - back * s, 0.9 * height), (0.45 * length, 1.45, 0.1 * height), yaw, reflectivity=paint)
    for ahead in (-0.31 * length, 0.31 * length):
        mesh.box((x + ahead * c, y + ahead * s, -0.02), (0.62, 1.7, 0.62), yaw, reflectivity=_RUBBER)


def _tree(mesh: Mesh, spot: tuple[float, float], height_m: float, rng: np.random.Generator) -> None:
    """A trunk and a crown of overlapping porous blobs."""
    x, y = spot
    r = 0.022 * height_m + 0.06
    trunk_m = 0.42 * height_m
    mesh.frustum((x, y, -0.4), (r * 1.3, r * 0.8), trunk_m + 0.8, 10, reflectivity=_WOOD)
    for _ in range(5):
        offset = rng.normal(0.0, 0.13 * height_m, 3)
        size = height_m * rng.uniform(0.13, 0.2)
        centre = (x + offset[0], y + offset[1], 0.68 * height_m + 0.6 * offset[2])
        mesh.blob(centre, (size, size, 0.85 * size), rng, holes=0.35, reflectivity=_LEAVES)
