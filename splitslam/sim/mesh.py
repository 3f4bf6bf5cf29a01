"""Triangle meshes of simple shapes: what a made world is built of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Point = tuple[float, float, float]

_BOX_QUADS = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])


class Mesh:
    """Triangles gathered shape by shape; lengths in m, world frame. `reflectivity` is 0 .. 255 as a VLP-16 tells it."""

    def __init__(self) -> None:
        self._triangles: list[Array] = []
        self._reflectivity: list[NDArray[np.uint8]] = []
        self._frames: list[tuple[Point, float]] = []

    def add(self, triangles: Array, reflectivity: int) -> None:
        """triangles (K, 3, 3): corner, coordinate."""
        for base, yaw_rad in reversed(self._frames):
            triangles = _placed(triangles, base, yaw_rad)
        self._triangles.append(triangles)
        self._reflectivity.append(np.full(len(triangles), reflectivity, np.uint8))

    @contextmanager
    def at(self, base: Point, yaw_rad: float = 0.0) -> Iterator[None]:
        """What is added inside stands in a frame of its own: origin at `base`, x axis turned by `yaw_rad`. Nests."""
        self._frames.append((base, yaw_rad))
        try:
            yield
        finally:
            self._frames.pop()

    def quads(self, corners: Array, *, reflectivity: int) -> None:
        """corners (K, 4, 3), each quad's in order round it."""
        self.add(np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]), reflectivity)

    def box(self, base: Point, size: Point, yaw_rad: float = 0.0, *, reflectivity: int) -> None:
        """Standing on `base` (the middle of its floor)."""
        corners = np.array([[x, y, z] for z in (0.0, 1.0) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]) * size
        self.add(_quads(_placed(corners, base, yaw_rad), _BOX_QUADS), reflectivity)

    def slab(self, start: tuple[float, float], end: tuple[float, float], bottom_m: float, size: tuple[float, float],
             *, reflectivity: int) -> None:  # fmt: skip
        """A wall, kerb or rail from `start` to `end`; size: thickness and height."""
        dx, dy = end[0] - start[0], end[1] - start[1]
        middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2, bottom_m)
        self.box(middle, (float(np.hypot(dx, dy)), *size), float(np.arctan2(dy, dx)), reflectivity=reflectivity)

    def frustum(self, base: Point, radii: tuple[float, float], height_m: float, sides: int = 12, *, reflectivity: int)\
            -> None:  # fmt: skip
        """A trunk, pole or cone: radii at the bottom and at the top."""
        turn = np.arange(sides) * 2 * np.pi / sides
        ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(sides)], axis=1)
        points = np.concatenate([ring * radii[0], ring * radii[1] + [0, 0, height_m], [[0, 0, height_m]]]) + base
        i = np.arange(sides)
        j = (i + 1) % sides
        side = _quads(points, np.stack([i, j, j + sides, i + sides], axis=1))
        lid = points[np.stack([i + sides, j + sides, np.full(sides, 2 * sides)], axis=1)]
        self.add(np.concatenate([side, lid]), reflectivity)

    def gable(self, base: Point, size: Point, *, reflectivity: int) -> None:
        """A roof with its ridge along x; size: length, width, height."""
        low = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
        points = np.concatenate([low, [[-0.5, 0, 1], [0.5, 0, 1]]]) * size + base
        self.add(_quads(points, np.array([[0, 2, 5, 4], [1, 3, 5, 4], [0, 2, 3, 1]])), reflectivity)
        self.add(points[np.array([[0, 1, 4], [2, 3, 5]])], reflectivity)

    def blob(self, centre: Point, radii: Point, rng: np.random.Generator, holes: float = 0.0, fineness: int = 3, *,
             reflectivity: int) -> None:  # fmt: skip
        """A bush or a crown: a bumpy ball; a share `holes` of its faces is missing, so that rays get inside."""
        points, faces = _icosphere(fineness)
        bumps = sum(np.cos(points @ rng.normal(0.0, k, 3) + rng.uniform(0, 2 * np.pi)) / k for k in (2.0, 4.0, 8.0))
        points = points * (1.0 + 0.16 * bumps + rng.normal(0.0, 0.05, len(points)))[:, None] * radii + centre
        self.add(points[faces[rng.random(len(faces)) >= holes]], reflectivity)

    def ground(self, low: tuple[float, float], high: tuple[float, float], step_m: float,
               height_m: Callable[[Array, Array], Array], *, reflectivity: int) -> None:  # fmt: skip
        """A height field over the rectangle from corner `low` to corner `high`."""
        x_axis, y_axis = (np.arange(a, b + step_m / 2, step_m) for a, b in zip(low, high, strict=True))
        x, y = np.meshgrid(x_axis, y_axis, indexing="ij")
        points = np.stack([x, y, height_m(x, y)], axis=-1).reshape(-1, 3)
        n = len(y_axis)
        corner = (np.arange(len(x_axis) - 1)[:, None] * n + np.arange(n - 1)).ravel()
        self.add(_quads(points, np.stack([corner, corner + n, corner + n + 1, corner + 1], axis=1)), reflectivity)

    def arrays(self) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """(K, 3, 3) float32 triangles and (K,) uint8 reflectivity."""
        return np.concatenate(self._triangles).astype(np.float32), np.concatenate(self._reflectivity)


def _placed(points: Array, base: Point, yaw_rad: float) -> Array:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + base


def _quads(points: Array, quads: NDArray[np.int64]) -> Array:
    return points[np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])]


@cache
def _icosphere(subdivisions: int) -> tuple[Array, NDArray[np.int64]]:
    """Unit sphere: points (V, 3) and faces (F, 3), an octahedron whose faces are split `subdivisions` times."""
    points = [np.array(p, float) for p in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))]
    faces = [(a, b, c) for a in (0, 1) for b in (2, 3) for c in (4, 5)]
    for _ in range(subdivisions):
        middles: dict[tuple[int, int], int] = {}

        def middle(a: int, b: int, middles: dict[tuple[int, int], int] = middles) -> int:
            key = (min(a, b), max(a, b))
            if key not in middles:
                p = points[a] + points[b]
                middles[key] = len(points)
                points.append(p / np.linalg.norm(p))
            return middles[key]

        split = []
        for a, b, c in faces:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            split += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = split
    return np.array(points), np.array(faces)
