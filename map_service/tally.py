"""Counters of a worker on their way to the front."""

from __future__ import annotations

import threading
from collections import defaultdict

from map_service.types import MapAnswer


class Tally:
    """What has happened since it was last taken; any thread may add."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: defaultdict[tuple[str, ...], float] = defaultdict(float)
        self._observations: list[tuple[tuple[str, ...], float]] = []

    def count(self, metric: str, *labels: str, by: float = 1) -> None:
        with self._lock:
            self._counts[(metric, *labels)] += by

    def observe(self, metric: str, value: float, *labels: str) -> None:
        with self._lock:
            self._observations.append(((metric, *labels), value))

    def mapped(self, answer: MapAnswer) -> None:
        """Counts a frame that was mapped, and how that went."""
        self.count("frames", "mapped")
        if answer.keyframe:
            self.count("keyframes")
        if answer.correction is not None:
            self.count("corrections", answer.correction.cause.name.lower())
            self.observe("correction_metres", answer.correction.translation_m)
        if (effort := answer.effort) is None:
            return
        self.observe("stage_seconds", effort.registration_s, "registration")
        if not effort.registered:
            return
        if not effort.features:
            self.count("registrations", "bare")
            return
        self.count("registrations", "degenerate" if len(answer.degenerate_axes) else "observed")
        self.observe("iterations", effort.iterations)
        self.observe("inliers", effort.inliers / effort.features)

    def take(self) -> tuple[dict[tuple[str, ...], float], list[tuple[tuple[str, ...], float]]]:
        with self._lock:
            taken = dict(self._counts), self._observations
            self._counts, self._observations = defaultdict(float), []
            return taken
