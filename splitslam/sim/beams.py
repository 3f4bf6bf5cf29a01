"""What a beam meets: the place, people, and, as faults, panes that are no surfaces and edges that split the beam."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from splitslam.sim import people
from splitslam.sim.places.materials import GLASS
from splitslam.sim.seeds import stream
from splitslam.sim.spec import DriveSpec
from splitslam.sim.trajectory import Trajectory
from splitslam.sim.world import Hits, World

Array = NDArray[np.float64]

_PULSE_M = 0.9  # echoes closer than the pulse is long are one echo to the sensor
_EDGE_M = 0.03  # the beam's rim is so far off the plane through its middle: an edge
_PANE_REFLECTANCE = 0.3  # coated glazing at 905 nm and normal incidence
_PANE_PASSES = 0.6  # of what it does not reflect
_GLINT_RAD = float(np.radians(1.0))  # so near to its normal a pane shines back by itself
_BEYOND_M = 2e-3  # a ray goes on behind or off a pane from here, not to meet it again


class Beams:
    """Beams on their way through a world with its people and with the faults of a drive."""

    def __init__(self, spec: DriveSpec, world: World, trajectory: Trajectory) -> None:
        self._world = world
        self._faults = spec.perturbations
        self._seed = spec.seed
        t_s = np.arange(0.0, spec.duration_s, 0.1)
        way_m = trajectory.poses(t_s)[1][:, :2]
        self._walkers = people.walkers(world.place, self._faults.walking_people, spec.seed, t_s, way_m)

    def cast(self, scan: int, t_s: Array, origins: Array, directions: Array) -> Hits:
        """What makes the echo of each beam. t_s (N,); origins, directions (N, 3), world frame, directions of length 1.

        `scan` numbers the random draws.
        """
        hits = self._echo(t_s, origins, directions)
        if self._faults.mixed_pixels_mrad > 0.0:
            hits = self._mixed(scan, hits, t_s, origins, directions)
        return hits

    def _echo(self, t_s: Array, origins: Array, directions: Array) -> Hits:
        hits = self._world.cast(origins, directions)
        if self._faults.glass > 0.0:
            hits = self._with_panes(hits, origins, directions)
        for walker in self._walkers:
            to_person = people.ranges_to_person(walker, self._world.place, t_s, origins, directions)
            n = len(to_person)  # round bodies: a mean tilt will do
            person = Hits(to_person, np.full(n, 0.8), np.full(n, float(people.REFLECTIVITY)), -directions)
            hits = hits.where(hits.range_m <= to_person, person)
        return hits

    def _with_panes(self, hits: Hits, origins: Array, directions: Array) -> Hits:
        """Where a beam meets glass, the strongest of three: the pane itself, what is behind it, what it mirrors.

        A pane is passed or mirrored by twice, so the energy counts squared; reflectance over the angle: Schlick,
        An Inexpensive BRDF Model (1994), eq. 24. The diffuse echo of dirt fades as `Perturbations.glass` goes to 1.
        """
        panes = np.flatnonzero(hits.reflectivity == GLASS)
        if len(panes) == 0:
            return hits
        pane, along = hits[panes], directions[panes]
        reflectance = _PANE_REFLECTANCE + (1.0 - _PANE_REFLECTANCE) * (1.0 - pane.cos_incidence) ** 5
        mirrored = along - 2.0 * np.einsum("ni,ni->n", along, pane.normal)[:, None] * pane.normal
        tilt = np.arccos(np.minimum(pane.cos_incidence, 1.0))
        glint = 255.0 * np.exp(-((tilt / _GLINT_RAD) ** 2))
        best = replace(pane, reflectivity=GLASS * (1.0 - self._faults.glass) + glint)
        foot = origins[panes] + pane.range_m[:, None] * along
        for way, gain in ((along, _PANE_PASSES * (1.0 - reflectance)), (mirrored, reflectance)):
            beyond = self._world.cast(foot + _BEYOND_M * way, way)
            range_m = beyond.range_m + pane.range_m + _BEYOND_M
            beyond = replace(beyond, range_m=range_m, reflectivity=beyond.reflectivity * gain**2)
            best = best.where(best.strength >= beyond.strength, beyond)
        whole = np.zeros(len(hits.range_m), np.int64)
        whole[panes] = np.arange(len(panes))
        other = np.ones(len(hits.range_m), bool)
        other[panes] = False
        return hits.where(other, best[whole])

    def _mixed(self, scan: int, hits: Hits, t_s: Array, origins: Array, directions: Array) -> Hits:
        """At an edge part of the beam goes past: two echoes within a pulse are one between them, else the stronger."""
        rng = stream(self._seed, "mixed pixels", scan)
        n = len(t_s)
        across = np.cross(directions, rng.normal(0.0, 1.0, (n, 3)))
        reach = 0.5e-3 * self._faults.mixed_pixels_mrad * np.sqrt(rng.random(n)) / np.linalg.norm(across, axis=1)
        rim = reach[:, None] * across
        share = rng.random(n)  # of the beam that goes past
        one, two = (self._echo(t_s, origins, _unit(directions + side * rim)) for side in (1.0, -1.0))
        with np.errstate(invalid="ignore"):
            bend = np.abs(one.range_m + two.range_m - 2.0 * hits.range_m)
            past = one.where(np.abs(one.range_m - hits.range_m) > np.abs(two.range_m - hits.range_m), two)
            apart = past.range_m - hits.range_m
        edges = (bend > _EDGE_M) & np.isfinite(hits.range_m) & np.isfinite(past.range_m)
        own, other = (1.0 - share) * hits.strength, share * past.strength
        weight = np.where(edges, other / np.maximum(own + other, 1e-30), 0.0)
        merged = edges & (np.abs(apart) < _PULSE_M)
        chosen = hits.where(weight <= 0.5, past)
        between = hits.range_m + np.where(merged, weight * np.where(merged, apart, 0.0), 0.0)
        return replace(chosen, range_m=np.where(merged, between, chosen.range_m))


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]
