"""`splitslam bench load`: the drive it plays, the search, and what it writes."""

from __future__ import annotations

import json
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from map_service.loops import LoopJob, LoopResult, verify
from splitslam.bench.load.costs import machine
from splitslam.bench.load.trial import P99_MS, Bench, Start, Trial, largest
from splitslam.errors import InputError
from splitslam.run.progress import Progress
from splitslam.stack.reel import Reel, record

_FIRST = 12  # robots of the first try
_AT_MOST = 128


@dataclass(frozen=True, slots=True)
class LoadOptions:
    """recording: None for a made drive, kept in `out`. robots: None for the search. workers: 0: its default."""

    out: Path
    recording: Path | None = None
    robot: Path | None = None
    robots: int | None = None
    seconds: float = 30.0
    start: Start = "together"
    workers: int = 0

    def __post_init__(self) -> None:
        """Raises InputError: one line that names the option and what was expected."""
        if self.robots is not None and not 1 <= self.robots <= _AT_MOST:
            raise InputError(f"--robots: expected 1 to {_AT_MOST}, found {self.robots}")
        if not self.seconds >= 1.0:
            raise InputError(f"--seconds: expected at least 1, found {self.seconds:g}")
        if self.start not in ("together", "spread"):
            raise InputError(f"--start: expected together or spread, found {self.start!r}")
        if not 0 <= self.workers <= 256:
            raise InputError(f"--workers: expected 0 to 256, found {self.workers}")
        if self.recording is not None and not self.robot_file.is_file():
            raise InputError(f"{self.robot_file}: expected a robot file beside the recording (or --robot)")

    @property
    def robot_file(self) -> Path:
        """Of the recording that was named."""
        assert self.recording is not None
        return self.robot or self.recording.with_suffix(".yaml")


class _AtOnce:
    """A LoopVerifier in this process, for the drive that answers are held against."""

    def submit(self, job: LoopJob) -> Future[LoopResult]:
        future: Future[LoopResult] = Future()
        future.set_result(verify(job))
        return future


def bench_load(options: LoadOptions, progress: Progress) -> dict[str, Any]:
    """Runs the tries, writes `out`/load.json, returns the same. Raises InputError, StackError."""
    options.out.mkdir(parents=True, exist_ok=True)
    measured_on = machine()
    reel = _reel(options, progress)
    if len(reel.frames) < options.seconds * 10:
        progress.note(f"the drive is {len(reel.frames) / 10:.0f} s long: robots play no longer")
    bench, trials = Bench(reel, options.workers), []

    def passes(robots: int, start: Start = options.start) -> bool:
        progress.stage(f"{robots} robots, {start}")
        trial = bench.try_out(robots, options.seconds, start)
        trials.append(trial)
        progress.note(_line(trial))
        return trial.passed

    if options.robots is not None:
        passes(options.robots)
        found = options.robots if trials[-1].passed else 0
    else:
        found = largest(passes, _FIRST, _AT_MOST)
        if found:  # the same robots as they are in the field, where no clock starts them together
            passes(found, "spread" if options.start == "together" else "together")
    best = next((t for t in trials if (t.robots, t.start) == (found, options.start)), trials[-1])
    result = {
        "machine": measured_on,
        "workers": options.workers or "default",
        "bar_ms": P99_MS,
        "largest": found,
        "best": best.as_dict(),
        "trials": [trial.as_dict() for trial in trials],
    }
    (options.out / "load.json").write_text(json.dumps(result, indent=1) + "\n")
    return result


def _line(trial: Trial) -> str:
    verdict = "ok" if trial.passed else "not in time" if not trial.wrong else trial.wrong[0]
    return f"{trial.robots} robots, {trial.start}: p99 {trial.answer_ms.p99:.0f} ms, {verdict}"


def _reel(options: LoadOptions, progress: Progress) -> Reel:
    scans = int(options.seconds * 10) + 1
    recording, robot = (options.recording, options.robot_file) if options.recording else _made(options, progress)
    progress.stage("making frames")
    return record(recording, robot, scans, _AtOnce())


def _made(options: LoadOptions, progress: Progress) -> tuple[Path, Path]:
    """The demo's drive, made once and kept."""
    from splitslam.sim import DEMO, simulate

    folder = options.out / "drive"
    bag, robot = folder / f"{DEMO.name}.bag", folder / f"{DEMO.name}.yaml"
    if not (bag.is_file() and robot.is_file()):
        progress.stage("making a drive")
        made = simulate(replace(DEMO, seed=1), folder, progress.made)
        bag, robot = made.bag_path, made.robot_path
    return bag, robot
