"""What the systems are run on: the recordings beside the project, and drives in made worlds."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from splitslam.errors import InputError

ROOT = Path(__file__).resolve().parent.parent
SPLITSLAM = Path(sys.executable).parent / "splitslam"
CLEAN, FAULTS = "none", "middle"  # of `splitslam sim --perturb`: nothing, everything at the middle setting


@dataclass(frozen=True, slots=True)
class Files:
    """A recording on disk. exact: the truth is (a made world's); else it has errors of its own."""

    bag: Path
    robot: Path
    truth: Path
    exact: bool = True


@dataclass(frozen=True, slots=True)
class Drive:
    """A recording of the tables. disable: what the full system must not use there, as its truth is made of it.

    recorded: its files' stem below the data folder and the truth's path; None: a drive of `splitslam sim`.
    seconds: how much of a made drive; 0: all.
    """

    name: str
    recorded: tuple[str, str] | None = None
    exact: bool = True
    disable: tuple[str, ...] = ()
    seconds: float = 0.0


_PSEUDO = "kitti_0005/kitti_0005.pseudo.tum"
RECORDED = (
    Drive("yard1", ("yard1/yard1", "yard1/yard1.tum")),
    Drive("kitti_0005_ring16", ("kitti_0005/kitti_0005_ring16", _PSEUDO), exact=False, disable=("gnss",)),
    Drive("kitti_0005_ring64_4s", ("kitti_0005/kitti_0005_ring64_4s", _PSEUDO), exact=False, disable=("gnss",)),
)
_SECONDS = {"campus": 45.0, "park": 45.0, "corridor": 60.0, "twins": 60.0, "street": 45.0, "moving_start": 45.0}
MADE = tuple(Drive(name, seconds=seconds) for name, seconds in _SECONDS.items())
# With the statistics of the paper's Table I; ten minutes and more of robot time each, so by name only.
LONG = tuple(Drive(name, seconds=0.0) for name in ("paper_walking", "paper_campus", "paper_park"))
DRIVES = {drive.name: drive for drive in (*RECORDED, *MADE, *LONG)}


@dataclass(frozen=True, slots=True)
class Case:
    """One recording: a drive with one setting of perturbations and one noise seed."""

    drive: Drive
    perturb: str = CLEAN
    seed: int = 1

    @property
    def name(self) -> str:
        """Of its files."""
        return f"{self.drive.name}.{self.perturb.replace('/', '_')}.{self.seed}"


def data_folder() -> Path:
    """$SPLITSLAM_DATA or ../shared/data."""
    return Path(os.environ.get("SPLITSLAM_DATA") or ROOT.parent / "shared" / "data")


def recorded_files(drive: Drive) -> Files:
    """Those of a recording; InputError when one is missing."""
    assert drive.recorded is not None
    stem, truth = (data_folder() / part for part in drive.recorded)
    files = Files(stem.with_suffix(".bag"), stem.with_suffix(".yaml"), truth, drive.exact)
    for path in (files.bag, files.robot, files.truth):
        if not path.is_file():
            raise InputError(f"{path}: expected a recording there (or set SPLITSLAM_DATA)")
    return files


def prepare(case: Case, folder: Path, seconds: float | None) -> Files:
    """The case's files, made in `folder` when it is a made drive, of which `seconds` are enough (None: its own).

    Raises InputError when a recording is missing or the simulator refuses.
    """
    if case.drive.recorded is not None:
        return recorded_files(case.drive)
    command = [str(SPLITSLAM), "sim", case.drive.name, "--out", str(folder)]
    command += ["--seed", str(case.seed), "--perturb", case.perturb]
    length_s = min(filter(None, (seconds, case.drive.seconds)), default=None)
    if length_s is not None:
        command += ["--seconds", f"{length_s:g}"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise InputError(f"splitslam sim {case.name}: {(result.stderr.strip() or 'failed').splitlines()[-1]}")
    stem = folder / case.drive.name
    return Files(Path(f"{stem}.bag"), Path(f"{stem}.yaml"), Path(f"{stem}.imu_truth.tum"))
