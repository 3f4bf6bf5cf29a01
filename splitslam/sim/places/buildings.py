"""Houses: a simple one with proud windows, and rows of houses whose windows are openings with panes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitslam.sim.mesh import Mesh
from splitslam.sim.places.materials import BRICK, CLOTH, CONCRETE, GLASS, METAL, PLASTER, ROOF, STONE, WOOD

_REVEAL_M = 0.16  # panes stand behind the wall's face
_ROOM_M = 4.5


def building(mesh: Mesh, centre: tuple[float, float], size: tuple[float, float], height_m: float, *, storeys: int,
              reflectivity: int, door_at: float) -> None:  # fmt: skip
    """A box with a base course, pilasters, window frames and sills, doors with a canopy, eaves and a roof."""
    (cx, cy), (length, width) = centre, size
    mesh.box((cx, cy, -0.5), (length, width, height_m + 0.5), reflectivity=reflectivity)
    mesh.box((cx, cy, -0.5), (length + 0.16, width + 0.16, 1.0), reflectivity=STONE)
    mesh.box((cx, cy, height_m), (length + 1.0, width + 1.0, 0.25), reflectivity=STONE)
    mesh.gable((cx, cy, height_m + 0.25), (length + 0.8, width + 0.8, min(3.0, 0.25 * width)), reflectivity=ROOF)
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
                    part(at, 0.14, 0.0, (1.7, 2.4), WOOD)
                    part(at, 0.9, 2.55, (2.4, 0.14), METAL)
                    part(at, 0.75, 0.0, (2.2, 0.15), STONE)
                    continue
                part(at, 0.06, z + 1.0, (1.5, 0.55 * storey_m), GLASS)
                part(at, 0.18, z + 0.9, (1.8, 0.1), STONE)
                part(at, 0.12, z + 1.0 + 0.55 * storey_m, (1.7, 0.12), STONE)


@dataclass(frozen=True)
class House:
    """A house in a row. A shop has wide panes on the ground floor."""

    length_m: float
    storeys: int
    storey_m: float
    depth_m: float = 10.0
    shop: bool = False
    balconies: bool = False
    reflectivity: int = PLASTER


def random_house(length_m: float, rng: np.random.Generator) -> House:
    """Two to five storeys, sometimes a shop, sometimes balconies."""
    return House(
        length_m=length_m,
        storeys=int(rng.integers(2, 6)),
        storey_m=float(rng.uniform(2.9, 3.5)),
        depth_m=float(rng.uniform(9.0, 12.0)),
        shop=bool(rng.random() < 0.35),
        balconies=bool(rng.random() < 0.3),
        reflectivity=int(rng.choice([PLASTER, BRICK, CONCRETE, STONE])),
    )


def house_in_row(mesh: Mesh, house: House, rng: np.random.Generator) -> None:
    """In the mesh's frame: the front from (0, 0) along x, the street on the side of -y; rooms behind its windows."""
    length, height = house.length_m, house.storeys * house.storey_m
    depth = house.depth_m
    flat = [((0, 0), (0, depth)), ((length, 0), (length, depth)), ((0, depth), (length, depth))]
    mesh.quads(np.array([_wall(a, b, -1.0, height) for a, b in flat]), reflectivity=house.reflectivity)
    mesh.quads(np.array([_wall((0, 0), (length, 0), -1.0, 0.0)]), reflectivity=STONE)
    bays = max(2, round(length / 2.9))
    door = int(rng.integers(0, bays))
    for floor in range(house.storeys):
        _storey(mesh, house, floor, bays, door, rng)
    mesh.box((length / 2, -0.12, height - 0.35), (length, 0.35, 0.35), reflectivity=STONE)
    mesh.gable((length / 2, depth / 2, height), (length, depth + 0.9, float(rng.uniform(2.0, 4.0))), reflectivity=ROOF)
    mesh.frustum((length - 0.12, -0.09, 0.0), (0.05, 0.05), height - 0.3, 6, reflectivity=METAL)
    if rng.random() < 0.6:
        at = float(rng.uniform(0.2, 0.8)) * length
        mesh.box((at, depth / 2 + 1.5, height), (0.7, 0.7, 4.4), reflectivity=BRICK)


def _storey(mesh: Mesh, house: House, floor: int, bays: int, door: int, rng: np.random.Generator) -> None:
    """One row of openings: bands above and below, piers between, panes a hand behind the wall, a room behind them."""
    width, z = house.length_m / bays, floor * house.storey_m
    shop = house.shop and floor == 0
    sill, head = z + (0.45 if shop else 0.95), z + house.storey_m - (0.45 if shop else 0.6)
    margin = width * (0.1 if shop else 0.26)
    left = np.arange(bays) * width + margin
    right = left + width - 2 * margin
    piers = zip(np.concatenate([[0.0], right]), np.concatenate([left, [house.length_m]]), strict=True)
    walls = [_wall((0, 0), (house.length_m, 0), z, sill), _wall((0, 0), (house.length_m, 0), head, z + house.storey_m)]
    walls += [_wall((a, 0), (b, 0), sill, head) for a, b in piers]
    walls += [_wall((x, 0), (x, _REVEAL_M), sill, head) for x in (*left, *right)]
    level = [_flat(a, b, 0.0, _REVEAL_M, at) for a, b in zip(left, right, strict=True) for at in (sill, head)]
    mesh.quads(np.array(walls + level), reflectivity=house.reflectivity)
    back = _wall((0, _ROOM_M), (house.length_m, _ROOM_M), z, z + house.storey_m)
    mesh.quads(np.array([back, _flat(0.0, house.length_m, 0.05, _ROOM_M, z + 0.02)]), reflectivity=PLASTER)
    for a, b in zip(left, right, strict=True):
        middle = float(a + b) / 2
        if floor == 0 and int(middle / width) == door:
            mesh.box((middle, 0.1, 0.0), (float(b - a) + 0.1, 0.1, head), reflectivity=WOOD)
            mesh.box((middle, -0.25, -0.4), (float(b - a) + 0.5, 0.6, 0.5), reflectivity=STONE)
            continue
        mesh.quads(np.array([_wall((a, _REVEAL_M), (b, _REVEAL_M), sill, head)]), reflectivity=GLASS)
        mesh.box((middle, _REVEAL_M, sill), (0.07, 0.08, head - sill), reflectivity=WOOD)
        mesh.box((middle, -0.03, sill - 0.07), (float(b - a) + 0.2, 0.22, 0.07), reflectivity=STONE)
        if rng.random() < 0.5:
            spot = (middle + float(rng.normal(0, 0.3)), float(rng.uniform(0.8, 3.0)), z)
            mesh.box(spot, (1.0, 0.6, float(rng.uniform(0.7, 1.9))), reflectivity=WOOD)
        if house.balconies and floor > 0 and int(middle / width) % 2 == 0:
            _balcony(mesh, middle, z + 0.05, float(b - a) + 0.6)
    if shop and rng.random() < 0.7:  # an awning
        slope = np.array([[0, 0, head + 0.3], [house.length_m, 0, head + 0.3], [house.length_m, -1.2, head - 0.1],
                          [0, -1.2, head - 0.1]])  # fmt: skip
        mesh.quads(slope[None], reflectivity=CLOTH)


def _balcony(mesh: Mesh, x: float, z: float, width_m: float) -> None:
    mesh.box((x, -0.55, z - 0.12), (width_m, 1.1, 0.14), reflectivity=CONCRETE)
    for rail in (0.5, 0.95):
        mesh.box((x, -1.07, z + rail), (width_m, 0.04, 0.05), reflectivity=METAL)
        for side in (-0.5, 0.5):
            mesh.box((x + side * width_m, -0.55, z + rail), (0.04, 1.05, 0.05), reflectivity=METAL)
    for post in np.linspace(-0.5, 0.5, 7):
        mesh.box((x + float(post) * width_m, -1.07, z), (0.03, 0.03, 1.0), reflectivity=METAL)


def _wall(a: tuple[float, float], b: tuple[float, float], low: float, high: float) -> list[list[float]]:
    return [[*a, low], [*b, low], [*b, high], [*a, high]]


def _flat(x0: float, x1: float, y0: float, y1: float, z: float) -> list[list[float]]:
    return [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]
