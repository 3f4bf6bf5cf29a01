"""Made range images for the feature core: walls with steps, holes, noise and cells hit twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from edge_agent.features.integer import RANGE_MAX
from fpga_overlay.golden import packet
from fpga_overlay.golden.deskew import DeskewedPoints
from fpga_overlay.golden.packet import Header


def points_of(ring: np.ndarray, column: np.ndarray, range_q: np.ndarray, seed: int = 0) -> DeskewedPoints:
    """Valid points in the order given, with coordinates that mean nothing: the core only passes them on."""
    rng = np.random.default_rng(seed)
    n = len(ring)
    ring, column, range_q = (np.asarray(a, np.int64) for a in (ring, column, range_q))
    points = rng.integers(-(1 << 23) + 1, 1 << 23, (n, 3))
    return DeskewedPoints(points, ring, column, range_q, np.full(n, packet.POINT_VALID, np.int64))


def spoilt(points: DeskewedPoints, share: float, seed: int = 0) -> DeskewedPoints:
    """That share of the points unusable or of a ring that the header does not have, as the first core leaves them."""
    rng = np.random.default_rng(seed)
    bad = rng.random(len(points.ring)) < share
    flags = np.where(bad, rng.choice([packet.POINT_UNUSABLE, packet.POINT_RING_OUTSIDE], len(bad)), points.flags)
    zero = ~bad
    return replace(
        points,
        points=points.points * zero[:, None],
        ring=np.where(flags == packet.POINT_RING_OUTSIDE, 255, points.ring),
        column=points.column * zero,
        range_q=points.range_q * zero,
        flags=flags,
    )


def wall_ranges(rng: np.random.Generator, n: int) -> np.ndarray:
    """(n,) ranges of a ring: pieces of wall with steps between them, most of them flat, some rough, some saturated."""
    borders = np.sort(rng.integers(0, n, max(1, n // 24)))
    piece = np.searchsorted(borders, np.arange(n), side="right")
    level = rng.integers(300, 60_000, piece[-1] + 1)
    slope = rng.integers(-40, 41, piece[-1] + 1)
    rough = rng.choice([1, 8, 60, 2000], piece[-1] + 1)
    ranges = level[piece] + slope[piece] * np.arange(n) + (rng.standard_normal(n) * rough[piece]).astype(np.int64)
    ranges = np.where(rng.random(n) < 0.01, RANGE_MAX, ranges)
    return np.clip(ranges, 1, RANGE_MAX)


def scan(
    header: Header, seed: int, *, filled: float = 0.8, repeated: float = 0.1, order: str = "columns"
) -> DeskewedPoints:
    """A scan that hits this share of the cells, and this share of them once more shortly after.

    order: `columns` (as a spinning lidar fires), `rings` or `random`.
    """
    rng = np.random.default_rng(seed)
    ring, column = np.nonzero(rng.random((header.rings, header.columns)) < filled)
    range_q = np.array([wall_ranges(rng, header.columns) for _ in range(header.rings)])[ring, column]
    place = {
        "columns": column * header.rings + ring,
        "rings": np.arange(len(ring)),
        "random": rng.permutation(len(ring)),
    }
    sequence = np.argsort(place[order])
    again = rng.random(len(ring)) < repeated
    moment = np.concatenate([np.arange(len(ring)), np.flatnonzero(again) + rng.integers(0, 6, again.sum()) + 0.5])
    source = np.concatenate([sequence, sequence[again]])[np.argsort(moment)]
    range_q = np.clip(range_q[source] + rng.integers(0, 3, len(source)), 1, RANGE_MAX)  # it shows which was first
    return points_of(ring[source], column[source], range_q, seed)


def directions(header: Header, points: DeskewedPoints) -> np.ndarray:
    """(N, 3) unit vectors into the middle of the points' columns, with an elevation for every ring."""
    azimuth = 2 * np.pi * (points.column - header.columns // 2) / header.columns
    elevation = np.radians(30.0 * points.ring / header.rings - 15.0)
    flat = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)]
    return np.column_stack([*flat, np.sin(elevation)])
