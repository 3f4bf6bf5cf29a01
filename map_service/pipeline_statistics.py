"""Counts and times of one session, as reports and metrics read them."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from map_service.series import Series
from map_service.tracker import Track
from map_service.types import CorrectionRecord, Effort

if TYPE_CHECKING:
    from map_service.pipeline import MapPipeline

Moment = tuple[float, float]  # wall and thread CPU time, s
STAGES = ("registration", "graph", "total")


class PipelineStatistics:
    """Survives no restart (the counts that must are in the pipeline's dump)."""

    def __init__(self) -> None:
        self.loops = 0
        self.gnss_factors = 0
        self.gravity_factors = 0
        self.corrections: dict[str, int] = {}
        self.largest_correction_m = 0.0
        self.degenerate_frames = 0
        self.iterations = 0
        self._cpu_ms = {stage: Series() for stage in STAGES}
        self._wall_ms = {stage: Series() for stage in STAGES}

    def correction(self, record: CorrectionRecord) -> None:
        """Counts a reported jump of T_map_odom."""
        cause = record.cause.name.lower()
        self.corrections[cause] = self.corrections.get(cause, 0) + 1
        self.largest_correction_m = max(self.largest_correction_m, record.translation_m)

    def frame(
        self, track: Track, started: Moment, registered: Moment, answered: Moment, began: Moment, ended: Moment
    ) -> float:
        """Adds one frame's stages: registration, and the graph's from there to the answer and from `began` to `ended`.

        Returns the graph's thread CPU time, s.
        """
        for series, i in ((self._wall_ms, 0), (self._cpu_ms, 1)):
            series["registration"].add((registered[i] - started[i]) * 1e3)
            graph_s = answered[i] - registered[i] + ended[i] - began[i]
            series["graph"].add(graph_s * 1e3)
            series["total"].add((registered[i] - started[i] + graph_s) * 1e3)
        if track.registration is not None:
            self.iterations += track.registration.iterations
            self.degenerate_frames += bool(track.registration.features and len(track.registration.degenerate_axes))
        return answered[1] - registered[1] + ended[1] - began[1]

    def report(self, mapped: int, keyframes: int, gnss_rejected: dict, loops_rejected: dict) -> dict:
        """JSON-ready."""
        return {
            "mapped": mapped,
            "keyframes": keyframes,
            "loops": self.loops,
            "loops_rejected": loops_rejected,
            "gnss_factors": self.gnss_factors,
            "gravity_factors": self.gravity_factors,
            "gnss_rejected": gnss_rejected,
            "map_count": sum(self.corrections.values()),
            "map_max_m": self.largest_correction_m,
            "corrections": dict(self.corrections),
            "degenerate_frames": self.degenerate_frames,
            "registration_iterations": self.iterations,
            "map_ms": {stage: series.summary() for stage, series in self._cpu_ms.items()},
            "map_wall_ms": {stage: series.summary() for stage, series in self._wall_ms.items()},
        }


def effort(track: Track, registration_s: float) -> Effort:
    """What placing a frame took, for metrics."""
    r = track.registration
    if r is None:
        return Effort(registration_s)
    return Effort(registration_s, True, r.iterations, r.inliers, r.features)


def outcomes(pipeline: MapPipeline) -> Counter[tuple[str, str]]:
    """What became of loops and fixes since the session began, by (metric, label)."""
    counts = Counter({("loops", "accepted"): pipeline.stats.loops, ("gnss", "accepted"): pipeline.stats.gnss_factors})
    if pipeline.closer is not None:
        counts.update({("loops", reason): n for reason, n in pipeline.closer.rejected.items()})
        counts.update({("loop_candidates", kind): n for kind, n in pipeline.closer.tried.items()})
    if pipeline.gnss is not None:
        counts.update({("gnss", reason): n for reason, n in pipeline.gnss.rejected.items()})
    return counts


def report(pipeline: MapPipeline) -> dict:
    """Counts and times so far (JSON-ready)."""
    gnss_rejected = {} if pipeline.gnss is None else dict(pipeline.gnss.rejected)
    loops_rejected = {} if pipeline.closer is None else dict(pipeline.closer.rejected)
    said = pipeline.stats.report(pipeline.mapped, len(pipeline.keyframes), gnss_rejected, loops_rejected)
    if pipeline.closer is not None:
        said["loops_tried"], said["loops_waiting"] = dict(pipeline.closer.tried), len(pipeline.closer.gate.waiting)
    return {**said, "loop_keyframes": [list(pair) for pair in pipeline.graph.loops]}
