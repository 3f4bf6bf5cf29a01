"""People who walk to and fro: the only things in a made world that move. Bodies are a few ellipsoids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.place import Place
from splitslam.sim.seeds import stream

Array = NDArray[np.float64]

REFLECTIVITY = 45
_CLEAR_M = 0.6
_TRIES = 100
_REACH_M = 0.9  # no part of a person is farther from the middle of the body, however the sensor moves in a scan
# Ellipsoids: middle's height, horizontal and vertical half-axes (m), swing of the stride (-1, 0, 1).
_PARTS = ((1.63, 0.10, 0.13, 0.0), (1.15, 0.20, 0.36, 0.0), (0.45, 0.10, 0.46, 1.0), (0.45, 0.10, 0.46, -1.0))


@dataclass(frozen=True)
class Walker:
    """Swings between two ends of a way with about walking speed in the middle."""

    a_m: tuple[float, float]
    b_m: tuple[float, float]
    phase_rad: float
    speed_mps: float

    def positions(self, t_s: Array) -> Array:
        """(N,) seconds -> (N, 2), m, world."""
        a, b = np.array(self.a_m), np.array(self.b_m)
        half = (b - a) / 2
        angle = self.phase_rad + self.speed_mps / max(float(np.linalg.norm(half)), 0.1) * t_s
        return (a + b) / 2 + np.cos(angle)[:, None] * half


def walkers(place: Place, count: int, seed: int, t_s: Array, way_m: Array) -> tuple[Walker, ...]:
    """`count` people spread over the place's walkways, who keep clear of the sensor: at times (N,) it is at (N, 2)."""
    rng = stream(seed, "people")
    ways = [place.walkways[k % len(place.walkways)] for k in range(count)] if place.walkways else []
    return tuple(_walker(way, rng, t_s, way_m) for way in ways)


def _walker(way: tuple[float, float, float, float], rng: np.random.Generator, t_s: Array, way_m: Array) -> Walker:
    ax, ay, bx, by = way
    for _ in range(_TRIES):
        walker = Walker((ax, ay), (bx, by), float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0.9, 1.4)))
        if np.linalg.norm(walker.positions(t_s) - way_m, axis=1).min() > _CLEAR_M:
            return walker
    raise ValueError(f"no walker on the way {way} keeps {_CLEAR_M} m from the sensor")


def ranges_to_person(walker: Walker, place: Place, t_s: Array, origins: Array, directions: Array) -> Array:
    """Range (N,) of each ray to the person where he is at that ray's own time; inf where it misses.

    t_s (N,); origins, directions (N, 3), world frame.
    """
    out = np.full(len(t_s), np.inf)
    middle = walker.positions(t_s[len(t_s) // 2 : len(t_s) // 2 + 1])[0]
    towards = middle - origins[len(t_s) // 2, :2]
    distance = float(np.linalg.norm(towards))
    near = np.arcsin(min(1.0, _REACH_M / max(distance, _REACH_M)))
    ahead = directions[:, :2] @ (towards / max(distance, 1e-9))
    rays = np.flatnonzero(ahead >= np.cos(near) * np.hypot(directions[:, 0], directions[:, 1]))
    if len(rays) == 0:
        return out
    t, origin, direction = t_s[rays], origins[rays], directions[rays]
    position = walker.positions(t)
    ground = place.ground_m(position[:, 0], position[:, 1])
    way = np.subtract(walker.b_m, walker.a_m) / np.linalg.norm(np.subtract(walker.b_m, walker.a_m))
    stride = 0.22 * np.sin(2 * np.pi * 0.9 * t)
    nearest = np.full(len(rays), np.inf)
    for height, radius, half_height, swing in _PARTS:
        centre = np.concatenate([position + np.outer(swing * stride, way), (ground + height)[:, None]], axis=1)
        nearest = np.minimum(nearest, _ellipsoid(origin - centre, direction, radius, half_height))
    out[rays] = nearest
    return out


def _ellipsoid(origin: Array, direction: Array, radius: float, half_height: float) -> Array:
    scale = 1.0 / np.array([radius, radius, half_height])
    o, d = origin * scale, direction * scale
    a, b = np.einsum("ni,ni->n", d, d), np.einsum("ni,ni->n", o, d)
    root = b * b - a * (np.einsum("ni,ni->n", o, o) - 1.0)
    near = (-b - np.sqrt(np.maximum(root, 0.0))) / a
    return np.where((root >= 0.0) & (near > 0.0), near, np.inf)
