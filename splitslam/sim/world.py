"""A made place, and rays cast into it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from splitslam.errors import InputError
from splitslam.sim.place import Place
from splitslam.sim.places.campus import build_campus
from splitslam.sim.places.corridor import build_corridor
from splitslam.sim.places.house import build_house
from splitslam.sim.places.park import build_park
from splitslam.sim.places.plain import build_plain
from splitslam.sim.places.quarter import build_quarter
from splitslam.sim.places.street import build_street
from splitslam.sim.places.twins import build_twins
from splitslam.sim.spec import WorldSpec

Array = NDArray[np.float64]

WORLDS: dict[str, Callable[[int], Place]] = {
    "campus": build_campus,
    "corridor": build_corridor,
    "house": build_house,
    "park": build_park,
    "plain": build_plain,
    "quarter": build_quarter,
    "street": build_street,
    "twins": build_twins,
}


@dataclass(frozen=True, eq=False)
class Hits:
    """What N rays met: range_m (N,), inf for nothing; cos_incidence (N,); reflectivity (N,), 0 .. 255; normal (N, 3),
    world frame, length 1, either way. All float64."""

    range_m: Array
    cos_incidence: Array
    reflectivity: Array
    normal: Array

    @property
    def strength(self) -> Array:
        """Energy that comes back, (N,): reflectivity * cos(incidence) / range^2."""
        return self.reflectivity * self.cos_incidence / np.maximum(self.range_m, 0.1) ** 2

    def __getitem__(self, rays: NDArray[np.int64]) -> Hits:
        return Hits(self.range_m[rays], self.cos_incidence[rays], self.reflectivity[rays], self.normal[rays])

    def where(self, keep: NDArray[np.bool_], other: Hits) -> Hits:
        """These where `keep` (N,) is true, those of `other` elsewhere."""
        return Hits(
            np.where(keep, self.range_m, other.range_m),
            np.where(keep, self.cos_incidence, other.cos_incidence),
            np.where(keep, self.reflectivity, other.reflectivity),
            np.where(keep[:, None], self.normal, other.normal),
        )


class World:
    """The standing part of a place, ready for ray casting (Embree)."""

    def __init__(self, place: Place) -> None:
        self.place = place
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, place.triangles)

    def cast(self, origins: Array, directions: Array) -> Hits:
        """First surface along each ray. origins, directions: (N, 3), world frame, directions of length 1."""
        answer = self._scene.run(origins.astype(np.float32), directions.astype(np.float32), output=1)
        hit = answer["primID"] >= 0
        normal = answer["Ng"].astype(np.float64)
        normal /= np.where(hit, np.sqrt(np.einsum("ni,ni->n", normal, normal)), 1.0)[:, None]
        return Hits(
            range_m=np.where(hit, answer["tfar"], np.inf).astype(np.float64),
            cos_incidence=np.where(hit, np.abs(np.einsum("ni,ni->n", normal, directions)), 0.0),
            reflectivity=np.where(hit, self.place.reflectivity[answer["primID"]], 0.0),
            normal=normal,
        )


@lru_cache(maxsize=4)
def make_world(spec: WorldSpec) -> World:
    """Builds the place of `spec` (once in a process); raises InputError for an unknown kind."""
    if spec.kind not in WORLDS:
        raise InputError(f"world kind {spec.kind!r} is not known: expected one of {', '.join(sorted(WORLDS))}")
    return World(WORLDS[spec.kind](spec.seed))
