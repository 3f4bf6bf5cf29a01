"""`splitslam demo`: a short drive in a made world, through both programs, scored against its exact truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from splitslam.errors import InputError
from splitslam.run.options import RunOptions, check_installed, check_picture
from splitslam.run.orchestrate import PROGRAMS, run_recording
from splitslam.run.processes import Programs, interruptible
from splitslam.run.progress import Progress
from splitslam.run.staging import staging

MIN_S = 5.0


def demo(
    out: Path,
    progress: Progress,
    *,
    seconds: float | None = None,
    seed: int = 1,
    picture: Path | None = None,
    programs: Programs = PROGRAMS,
) -> dict[str, Any]:
    """Make the drive, run it, write recording, truth and all results into `out`; returns report.json.

    seconds: how long the drive is; None: as long as the loop closure takes. seed: of the sensors' noise. picture: where
    a PNG goes. Raises what run_recording raises.
    """
    if seconds is not None and not seconds >= MIN_S:
        raise InputError(f"--seconds: expected at least {MIN_S:g}, found {seconds:g}")
    check_picture(picture)
    check_installed(("sim", "viz", "edge", "server"))
    from splitslam.sim import DEMO, simulate

    spec = replace(DEMO, seed=seed, duration_s=DEMO.duration_s if seconds is None else seconds)
    with interruptible(), staging(out) as stage:
        progress.stage("making a drive")
        made = simulate(spec, stage.results, progress.made)
        options = RunOptions(
            recording=made.bag_path, robot=made.robot_path, out=out, truth=made.truth_path, picture=picture
        )
        report = run_recording(options, progress, programs)
        stage.publish()
    return report
