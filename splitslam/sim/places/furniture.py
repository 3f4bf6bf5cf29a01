"""What stands about outdoors: lamps, benches, cars, trees."""

from __future__ import annotations

import numpy as np

from splitslam.sim.mesh import Mesh
from splitslam.sim.places.materials import CLOTH, CONCRETE, GLASS, LEAVES, METAL, PLASTER, RUBBER, SIGN, WOOD


def lamp(mesh: Mesh, x: float, y: float, height_m: float) -> None:
    mesh.frustum((x, y, -0.3), (0.16, 0.16), 0.9, reflectivity=CONCRETE)
    mesh.frustum((x, y, 0.5), (0.08, 0.05), height_m - 0.5, 8, reflectivity=METAL)
    mesh.box((x, y + 0.4, height_m - 0.1), (0.25, 1.0, 0.12), reflectivity=METAL)


def bench(mesh: Mesh, x: float, y: float, yaw: float) -> None:
    c, s = np.cos(yaw), np.sin(yaw)
    mesh.box((x, y, 0.4), (1.7, 0.45, 0.07), yaw, reflectivity=WOOD)
    mesh.box((x - 0.22 * s, y + 0.22 * c, 0.47), (1.7, 0.06, 0.4), yaw, reflectivity=WOOD)
    for d in (-0.65, 0.65):
        mesh.box((x + d * c, y + d * s, -0.2), (0.12, 0.4, 0.62), yaw, reflectivity=CONCRETE)


def car(mesh: Mesh, x: float, y: float, yaw: float, rng: np.random.Generator) -> None:
    """Body, cabin, wheels; every car a little different."""
    c, s = np.cos(yaw), np.sin(yaw)
    length, height = rng.uniform(3.9, 4.7), rng.uniform(1.4, 1.65)
    paint = int(rng.choice([12, 35, 70, 90]))
    mesh.box((x, y, 0.28), (length, 1.78, 0.5 * height - 0.1), yaw, reflectivity=paint)
    back = rng.uniform(0.1, 0.5)
    mesh.box((x - back * c, y - back * s, 0.5 * height), (0.58 * length, 1.6, 0.4 * height), yaw, reflectivity=GLASS)
    mesh.box((x - back * c, y - back * s, 0.9 * height), (0.45 * length, 1.45, 0.1 * height), yaw, reflectivity=paint)
    for ahead in (-0.31 * length, 0.31 * length):
        mesh.box((x + ahead * c, y + ahead * s, -0.02), (0.62, 1.7, 0.62), yaw, reflectivity=RUBBER)


def tree(mesh: Mesh, spot: tuple[float, float], height_m: float, rng: np.random.Generator) -> None:
    """A trunk and a crown of overlapping porous blobs."""
    x, y = spot
    r = 0.022 * height_m + 0.06
    trunk_m = 0.42 * height_m
    mesh.frustum((x, y, -0.4), (r * 1.3, r * 0.8), trunk_m + 0.8, 10, reflectivity=WOOD)
    for _ in range(5):
        offset = rng.normal(0.0, 0.13 * height_m, 3)
        size = height_m * rng.uniform(0.13, 0.2)
        centre = (x + offset[0], y + offset[1], 0.68 * height_m + 0.6 * offset[2])
        mesh.blob(centre, (size, size, 0.85 * size), rng, holes=0.35, reflectivity=LEAVES)


def van(mesh: Mesh, x: float, y: float, yaw: float, rng: np.random.Generator) -> None:
    """A delivery van: a high box, a sloped front, wheels."""
    c, s = np.cos(yaw), np.sin(yaw)
    paint = int(rng.choice([35, 70, 90]))
    mesh.box((x - 0.5 * c, y - 0.5 * s, 0.3), (4.4, 1.95, 1.9), yaw, reflectivity=paint)
    mesh.box((x + 2.2 * c, y + 2.2 * s, 0.3), (1.0, 1.9, 0.9), yaw, reflectivity=paint)
    mesh.box((x + 1.95 * c, y + 1.95 * s, 1.2), (0.5, 1.7, 0.75), yaw, reflectivity=GLASS)
    for ahead in (-1.7, 1.8):
        mesh.box((x + ahead * c, y + ahead * s, -0.02), (0.68, 1.85, 0.68), yaw, reflectivity=RUBBER)


def road_sign(mesh: Mesh, rng: np.random.Generator) -> None:
    """A plate on a pole, at the origin of the mesh's frame."""
    mesh.frustum((0.0, 0.0, -0.3), (0.04, 0.04), 2.9, 8, reflectivity=METAL)
    mesh.box((0.04, 0.0, 2.0), (0.03, 0.6, float(rng.uniform(0.4, 0.7))), float(rng.normal(0, 0.2)), reflectivity=SIGN)


def bollard(mesh: Mesh) -> None:
    """Knee-high, at the origin of the mesh's frame."""
    mesh.frustum((0.0, 0.0, -0.2), (0.09, 0.07), 1.1, 8, reflectivity=METAL)


def bush(mesh: Mesh, x: float, y: float, size_m: float, rng: np.random.Generator) -> None:
    """Two or three overlapping porous blobs that reach the ground."""
    for _ in range(int(rng.integers(2, 4))):
        dx, dy = rng.normal(0.0, 0.4 * size_m, 2)
        r = size_m * float(rng.uniform(0.6, 1.0))
        mesh.blob((x + dx, y + dy, 0.55 * r), (r, r, 0.8 * r), rng, holes=0.3, fineness=2, reflectivity=LEAVES)


def potted_plant(mesh: Mesh, x: float, y: float, rng: np.random.Generator) -> None:
    """A tub and leaves, chest-high."""
    mesh.frustum((x, y, 0.0), (0.3, 0.38), 0.55, 12, reflectivity=CONCRETE)
    mesh.blob((x, y, 1.1), (0.5, 0.5, 0.7), rng, holes=0.3, fineness=2, reflectivity=LEAVES)


def shelf(mesh: Mesh, rng: np.random.Generator) -> None:
    """3.6 m wide, 0.9 m deep, boxes on three boards; middle of the foot at the origin of the mesh's frame."""
    for z in (0.1, 1.2, 2.3):
        mesh.box((0.0, 0.0, z), (3.6, 0.9, 0.06), reflectivity=METAL)
        for x in np.arange(-1.5, 1.6, 0.75).tolist():
            if rng.random() < 0.7:
                length, width, height = rng.uniform((0.4, 0.4, 0.3), (0.7, 0.8, 0.9)).tolist()
                material = int(rng.choice([WOOD, CLOTH, PLASTER]))
                mesh.box((x, 0.0, z + 0.06), (length, width, height), float(rng.normal(0, 0.05)), reflectivity=material)
    for x in (-1.75, 1.75):
        for y in (-0.42, 0.42):
            mesh.box((x, y, 0.0), (0.08, 0.08, 3.2), reflectivity=METAL)
