"""A made place, and rays cast into it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from splitslam.errors import InputError
from splitslam.sim.place import Place
from splitslam.sim.places.campus import build_campus
from splitslam.sim.places.corridor import build_corridor
from splitslam.sim.places.park import build_park
from splitslam.sim.places.street import build_street
from splitslam.sim.spec import WorldSpec

Array = NDArray[np.float64]

WORLDS: dict[str, Callable[[int], Place]] = {
    "campus": build_campus,
    "corridor": build_corridor,
    "park": build_park,
    "street": build_street,
}


@dataclass(frozen=True, eq=False)
class Hits:
    """What N rays met. range_m (N,) float64, inf for nothing; cos_incidence (N,) float64; reflectivity (N,) uint8."""

    range_m: Array
    cos_incidence: Array
    reflectivity: NDArray[np.uint8]


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
        length = np.where(hit, np.linalg.norm(normal, axis=1), 1.0)
        cosine = np.abs(np.einsum("ni,ni->n", normal, directions)) / length
        return Hits(
            range_m=np.where(hit, answer["tfar"], np.inf).astype(np.float64),
            cos_incidence=np.where(hit, cosine, 0.0),
            reflectivity=np.where(hit, self.place.reflectivity[answer["primID"]], 0).astype(np.uint8),
        )


def make_world(spec: WorldSpec) -> World:
    """Builds the place of `spec`; raises InputError for an unknown kind."""
    if spec.kind not in WORLDS:
        raise InputError(f"world kind {spec.kind!r} is not known: expected one of {', '.join(sorted(WORLDS))}")
    return World(WORLDS[spec.kind](spec.seed))
