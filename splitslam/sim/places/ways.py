"""Waypoints of common ways."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Waypoints = tuple[tuple[float, float], ...]


def rounded(corners: Waypoints, radius_m: float, step_m: float, *, closed: bool) -> Waypoints:
    """A way along straight lines between `corners` with arcs of `radius_m` where they meet, every `step_m` or so."""
    points = np.array(corners, float)
    count = len(points)
    bends = range(count) if closed else range(1, count - 1)
    pieces: list[Array] = [] if closed else [points[:1]]
    for k in bends:
        pieces.append(_arc(points[k - 1], points[k], points[(k + 1) % count], radius_m, step_m))
    if not closed:
        pieces.append(points[-1:])
    ends = [*pieces, pieces[0]] if closed else pieces
    out: list[Array] = []
    for piece, following in itertools.pairwise(ends):
        gap = float(np.linalg.norm(following[0] - piece[-1]))
        share = np.linspace(0.0, 1.0, max(2, round(gap / step_m) + 1))[1:-1, None]
        out += [piece, piece[-1] + share * (following[0] - piece[-1])]
    if not closed:
        out.append(pieces[-1])
    return tuple((float(x), float(y)) for x, y in np.concatenate(out))


def _arc(before: Array, corner: Array, after: Array, radius_m: float, step_m: float) -> Array:
    """Points (K, 2) of the arc that touches both legs of a corner."""
    u, v = (end - corner for end in (before, after))
    u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
    half = np.arccos(np.clip(u @ v, -1.0, 1.0)) / 2
    if half > np.pi / 2 - 1e-6:
        return corner[None]
    centre = corner + (u + v) / np.linalg.norm(u + v) * radius_m / np.sin(half)
    start, end = (corner + leg * radius_m / np.tan(half) - centre for leg in (u, v))
    sweep = float(np.arctan2(start[0] * end[1] - start[1] * end[0], start @ end))
    length = abs(sweep) * radius_m
    if length < step_m:  # points closer than the others would bend a spline through them
        return corner[None]
    turn = np.linspace(0.0, sweep, max(3, round(length / step_m) + 1))[:, None]
    return centre + np.cos(turn) * start + np.sin(turn) * np.array([-start[1], start[0]])
