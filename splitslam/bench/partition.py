"""The paper's experiment on recordings: what each cut through LIO-SAM sends, and how long a scan takes with it.

Ours goes through both programs, and its bytes are all that TCP carried. The other cuts, and every time, come from a
second pass with both pipelines in this process.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean
from typing import Any

from edge_agent.features.integer import FeatureMarks
from edge_agent.settings import PipelineSettings
from edge_agent.stage_clock import StageClock
from edge_agent.tally import RAW_IMU_BYTES
from splitslam.bench import laz, lio_sam
from splitslam.bench.in_one_process import Outcome, Seen, run_both
from splitslam.bench.options import PartitionOptions
from splitslam.bench.partition_plot import draw
from splitslam.bench.partition_result import Case, Partition, as_dict
from splitslam.errors import InputError
from splitslam.features import FeatureFrame
from splitslam.run.options import RunOptions
from splitslam.run.orchestrate import run_recording
from splitslam.run.processes import interruptible
from splitslam.run.progress import Progress
from splitslam.run.staging import staging


def bench_partition(options: PartitionOptions, progress: Progress) -> tuple[list[Partition], dict[str, Any]]:
    """Measures, and writes partition.json and partition.png into `options.out`; returns what is in them.

    Raises InputError for bad input, RunFailedError for a program that did not finish; then nothing is written.
    """
    with interruptible(), staging(options.out) as stage:
        found = [_measure(run, progress) for run in options.runs(stage.work)]
        result = as_dict(found, laz_missing=not laz.installed())
        text = json.dumps(result, indent=1, allow_nan=False)
        (stage.results / "partition.json").write_text(text + "\n", encoding="utf-8")
        (stage.results / "partition.png").write_bytes(draw(found))
        stage.publish()
    return found, result


def _measure(run: RunOptions, progress: Progress) -> Partition:
    uplink = _checked(run_recording(run, progress), run.recording)
    progress.stage(f"{run.recording.stem}: the other cuts")
    probe = _Probe(lambda done: progress.scan(done, done))
    # programmable logic would hand over no ranges; its times are not this processor's
    settings = PipelineSettings(deskew="cpu")
    mapped = run_both(
        run.recording,
        run.robot,
        wire=probe,
        max_scans=run.max_scans,
        disable=run.disable,
        edge_settings=settings,
        max_kbps=run.max_kbps,
    )
    return probe.result(run.recording.stem, uplink, mapped)


def _checked(report: dict[str, Any], recording: Path) -> dict[str, Any]:
    if not report["recording_s"] > 0:
        raise InputError(f"{recording}: expected a recording of some seconds, found one message time")
    return {**report["uplink"], "recording_s": report["recording_s"]}


@dataclass(slots=True)
class _Probe:
    """Sees every scan between edge and map, and makes what the other cuts would send of it."""

    on_scan: Callable[[int], None]
    sizes: dict[str, list[int]] = field(default_factory=dict)
    times_ms: dict[str, list[float]] = field(default_factory=dict)
    _features: lio_sam.LioSamFeatures | None = None
    _laz: laz.Laz | None = None
    _rings_columns: tuple[int, int] = (0, 0)

    def __call__(self, seen: Seen) -> FeatureFrame:
        rings, image, scan = len(seen.beam_elevations_rad), seen.image, seen.scan
        if self._features is None:
            self._features = lio_sam.LioSamFeatures(rings, seen.columns)
            self._laz = laz.Laz() if laz.installed() else None
            self._rings_columns = rings, seen.columns
        assert image.range_q is not None
        clock = StageClock()
        decoded = seen.decoded()
        clock.lap("decode")
        raw = lio_sam.raw_message(scan.points_lidar, scan.ring, scan.t_offset_ns)
        clock.lap("pack_raw")
        deskewed = lio_sam.deskewed_message(image)
        clock.lap("pack_deskewed")
        marks = FeatureMarks.of(image.range_q, image.column, image.ring_start, self._features.limits)
        corners, surfs = self._features.select(image, marks)
        clock.lap("lio_sam_features")
        features = lio_sam.feature_message(image, corners, surfs)
        clock.lap("pack_features")
        self._add(
            {
                "points": len(scan),
                "image": len(image),
                "features": len(corners) + len(surfs),
                "ours": seen.frame.corners + seen.frame.surfs,
                "case1": len(raw),
                "case2": len(deskewed),
                "case3": len(features),
                "laz": self._laz.size(scan.points_lidar, scan.ring) if self._laz else 0,
            },
            {**clock.cpu_ms, **seen.frame.stage_cpu_ms},
        )
        return decoded

    def _add(self, sizes: dict[str, int], times_ms: dict[str, float]) -> None:
        for name, size in sizes.items():
            self.sizes.setdefault(name, []).append(size)
        for name, time_ms in times_ms.items():
            self.times_ms.setdefault(name, []).append(time_ms)
        self.on_scan(len(self.sizes["points"]))

    def result(self, name: str, uplink: dict[str, Any], mapped: Outcome) -> Partition:
        """uplink: of the run's report.json, and its recording_s."""
        scans, size = len(self.sizes["points"]), {key: fmean(values) for key, values in self.sizes.items()}
        # the first scan finds cold caches and kernels that are still being read
        ms = {key: fmean(values[1:] or values) for key, values in self.times_ms.items()}
        image_ms = {"motion": ms["motion"], "deskew": ms["deskew"]}
        features_ms = {"features": ms["lio_sam_features"]}
        imu_bytes = RAW_IMU_BYTES * mapped.counts.imu_messages / scans
        cases = {
            "case1": Case(size["points"], size["case1"], imu_bytes, {"pack": ms["pack_raw"]}, image_ms | features_ms),
            "case2": Case(size["image"], size["case2"], 0, image_ms | {"pack": ms["pack_deskewed"]}, features_ms),
            "case3": Case(
                size["features"], size["case3"], 0, image_ms | features_ms | {"pack": ms["pack_features"]}, {}
            ),
            "ours": Case(
                size["ours"],
                uplink["bytes"] / scans,
                0,
                image_ms | {"features": ms["features"], "encode": ms["encode"]},
                {"decode": ms["decode"]},
            ),
        }
        deskewed, features = round(size["image"]), round(size["features"])
        return Partition(
            name=name,
            scans=scans,
            recording_s=uplink["recording_s"],
            points=size["points"],
            native_bytes=mapped.counts.native_bytes / scans or None,
            laz_bytes=size["laz"] or None,
            cases=cases,
            ros_bytes={
                "case2": lio_sam.ros_bytes(*self._rings_columns, deskewed),
                "case3": lio_sam.ros_bytes(*self._rings_columns, deskewed, features),
            },
            edge_max_ms=max(self.times_ms["total"][1:] or self.times_ms["total"]),
        )
