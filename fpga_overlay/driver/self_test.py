"""A made scan that uses every part of the logic, and the golden model's word on the answer."""

from __future__ import annotations

import numpy as np

from fpga_overlay.driver.request import Request
from fpga_overlay.golden import features
from fpga_overlay.golden.packet import Beats
from splitslam.features import Knots
from splitslam.scan import Scan

_SCAN_NS = 100_000_000
_TURN_RADPS = np.radians(217.0)


def made_scan(rings: int) -> Scan:
    """A scan turning once: smooth, rough and stepped; points of one cell, of a ring that is none, NaN, Inf and far."""
    count = max(3000, 100 * rings)
    index = np.arange(count)
    ring = (index % rings).astype(np.uint8)
    azimuth = np.pi - 2 * np.pi * index / count
    range_m = 8.0 + 3.0 * np.maximum(np.sin(5 * azimuth), 0) + 20.0 * (np.sin(9 * azimuth) > 0.6) + 0.02 * ring
    elevation = np.radians(-15.0 + 30.0 * ring / rings)
    direction = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    points = (range_m * np.array(direction)).T.astype(np.float32)
    points[17], points[1200], points[2500] = np.nan, [np.inf, 1, 1], [600, 0, 0]
    points[40 + rings], ring[2000] = points[40], min(rings, 255)
    time = (index * (_SCAN_NS // count)).astype(np.int32)
    return Scan(0, int(time[-1]), points, time, ring, np.zeros(count, np.uint8))


def made_knots() -> Knots:
    """A fast turn to the left at a run, from 1 ms after the scan's start to 1 ms before its end."""
    offsets = np.arange(1_000_000, _SCAN_NS, 2_000_000)
    t = offsets * 1e-9
    rotation = np.stack([0.05 * np.sin(9 * t), 0.2 * t, _TURN_RADPS * t], axis=1, dtype=np.float64)
    translation = np.stack([1.4 * t, 0.3 * t * t, 0.05 * np.sin(12 * t)], axis=1, dtype=np.float64)
    return Knots(offsets, rotation, translation)


def first_difference(request: Request, answer: Beats) -> str:
    """Where an answer departs from the golden model's, and how; empty if it does not."""
    expected = features.answer(request.header, request.table.words, request.points)
    if len(answer) != len(expected):
        return f"{len(answer)} beats, expected {len(expected)}"
    wrong = np.flatnonzero((answer != expected).any(axis=1))
    if not len(wrong):
        return ""
    seen, right = (" ".join(f"{word:08x}" for word in beats[wrong[0]]) for beats in (answer, expected))
    return f"{len(wrong)} beats differ, the first is {wrong[0]}: {seen}, expected {right}"
