"""The edge's time by scan, in software and with the overlay's cores: the paper's section V-D on this machine."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from edge_agent.settings import PipelineSettings
from splitslam.bench import edge_fpga
from splitslam.bench.edge_made import made_drive
from splitslam.bench.edge_plot import draw
from splitslam.bench.edge_result import STAGES, Accelerated, EdgeTimes, as_dict
from splitslam.bench.in_one_process import Seen, run_both
from splitslam.bench.options import EdgeOptions
from splitslam.errors import InputError
from splitslam.features import FeatureFrame
from splitslam.run.processes import RunFailedError, interruptible
from splitslam.run.progress import Progress
from splitslam.run.staging import staging


def bench_edge(options: EdgeOptions, progress: Progress) -> tuple[list[EdgeTimes], dict[str, Any]]:
    """Measures, and writes edge.json and edge.png into `options.out`; returns what is in them.

    Without recordings, drives are made in `options.out`/made for each LiDAR, or taken from there. Raises InputError
    for bad input; then nothing is written.
    """
    fpga = options.fpga and edge_fpga.installed()
    with interruptible(), staging(options.out) as stage:
        found = [_measure(*drive, options.max_scans, fpga, progress) for drive in _drives(options, progress)]
        said = edge_fpga.MEASURED if fpga else edge_fpga.MISSING if options.fpga else "not asked for"
        result = as_dict(found, said)
        text = json.dumps(result, indent=1, allow_nan=False)
        (stage.results / "edge.json").write_text(text + "\n", encoding="utf-8")
        (stage.results / "edge.png").write_bytes(draw(found))
        stage.publish()
    return found, result


def _drives(options: EdgeOptions, progress: Progress) -> list[tuple[Path, Path]]:
    """(recording, robot file) each."""
    if options.recordings:
        return options.drives()
    made = []
    for grid in options.grids:
        progress.stage(f"making {grid}")
        made.append(made_drive(grid, options.seconds, options.out / "made", progress.made))
    return made


def _measure(recording: Path, robot: Path, max_scans: int | None, fpga: bool, progress: Progress) -> EdgeTimes:
    progress.stage(f"{recording.stem}: in software")
    probe = _Probe(progress)
    run_both(recording, robot, wire=probe, max_scans=max_scans, edge_settings=PipelineSettings(deskew="cpu"))
    accelerated = None
    if fpga:
        progress.stage(f"{recording.stem}: with the cores")
        try:
            accelerated = edge_fpga.accelerated(recording, robot, max_scans)
        except RunFailedError as error:
            progress.note(f"{recording.stem}: {error}")
    return probe.result(recording, accelerated)


@dataclass(slots=True)
class _Probe:
    """Notes the times of every scan that goes from edge to map."""

    progress: Progress
    points: list[int] = field(default_factory=list)
    times_ms: list[dict[str, float]] = field(default_factory=list)
    lidar: str = ""

    def __call__(self, seen: Seen) -> FeatureFrame:
        self.points.append(len(seen.scan))
        self.times_ms.append(dict(seen.frame.stage_cpu_ms))
        self.lidar = f"{len(seen.beam_elevations_rad)}x{seen.columns}"
        self.progress.scan(len(self.points), len(self.points))
        return seen.decoded()

    def result(self, recording: Path, accelerated: Accelerated | None) -> EdgeTimes:
        # the first scan finds cold caches and kernels that are still being read
        rows = self.times_ms[1:]
        if not rows:
            raise InputError(f"{recording}: expected at least two scans, found {len(self.times_ms)}")
        ms = {stage: np.array([row[stage] for row in rows]) for stage in (*STAGES, "total")}
        return EdgeTimes(recording.stem, self.lidar, fmean(self.points), ms, accelerated)
