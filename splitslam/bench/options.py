"""What `splitslam bench` was asked for, checked before anything is loaded or started."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from splitslam.bench.edge_made import GRIDS, MAX_S
from splitslam.errors import InputError
from splitslam.robot import load_robot
from splitslam.run.options import RunOptions
from splitslam.sim.grid_lidar import Grid


@dataclass(frozen=True, slots=True)
class PartitionOptions:
    """robot: None for the robot file beside each recording. disable, max_kbps: as of `splitslam run`."""

    recordings: tuple[Path, ...]
    out: Path
    robot: Path | None = None
    max_scans: int | None = None
    disable: tuple[str, ...] = ()
    max_kbps: float | None = None

    def __post_init__(self) -> None:
        """Raises InputError: one line that names the option and what was expected."""
        if self.robot is not None and len(self.recordings) > 1:
            raise InputError(f"--robot: expected one recording with it, found {len(self.recordings)}")
        for run in self.runs(self.out):
            load_robot(run.robot)

    def runs(self, work: Path) -> list[RunOptions]:
        """One run each, into folders of `work`."""
        return [
            RunOptions(
                recording=recording,
                robot=self.robot or _beside(recording),
                out=work / f"run{number}",
                max_scans=self.max_scans,
                disable=self.disable,
                max_kbps=self.max_kbps,
            )
            for number, recording in enumerate(self.recordings)
        ]


def _beside(recording: Path) -> Path:
    robot = recording.with_suffix(".yaml")
    if recording.exists() and not robot.is_file():
        raise InputError(f"{robot}: expected a robot file beside the recording (or --robot)")
    return robot


@dataclass(frozen=True, slots=True)
class EdgeOptions:
    """recordings: none for made drives of `seconds` with LiDARs of `grids`. robot: as of PartitionOptions.

    fpga: with the overlay's cores as well, where their environment is.
    """

    recordings: tuple[Path, ...]
    out: Path
    robot: Path | None = None
    grids: tuple[Grid, ...] = GRIDS
    seconds: float = 8.0
    max_scans: int | None = None
    fpga: bool = True

    def __post_init__(self) -> None:
        """Raises InputError: one line that names the option and what was expected."""
        if self.robot is not None and len(self.recordings) != 1:
            raise InputError(f"--robot: expected one recording with it, found {len(self.recordings)}")
        if not 1.0 <= self.seconds <= MAX_S:
            raise InputError(f"--seconds: expected 1 to {MAX_S:g}, found {self.seconds:g}")
        if not self.recordings and not self.grids:
            raise InputError("--grids: expected RINGSxCOLUMNS, separated by commas, found none")
        for recording, robot in self.drives():
            RunOptions(recording=recording, robot=robot, out=self.out, max_scans=self.max_scans)
            load_robot(robot)

    def drives(self) -> list[tuple[Path, Path]]:
        """(recording, robot file) each."""
        return [(recording, self.robot or _beside(recording)) for recording in self.recordings]


@dataclass(frozen=True, slots=True)
class DelayOptions:
    """delays_ms: of the answers. robot, truth: None for the files beside the recording, if there is a truth."""

    recording: Path
    out: Path
    delays_ms: tuple[float, ...]
    robot: Path | None = None
    truth: Path | None = None
    max_scans: int | None = None
    disable: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raises InputError: one line that names the option and what was expected."""
        load_robot(self.run(self.out).robot)
        if not self.delays_ms:
            raise InputError("--delays: expected milliseconds, separated by commas, found none")
        for delay_ms in self.delays_ms:
            if not 0 <= delay_ms <= 60_000:
                raise InputError(f"--delays: expected 0 to 60000 ms, found {delay_ms:g}")

    def run(self, out: Path) -> RunOptions:
        """What it has in common with `splitslam run`, checked."""
        return RunOptions(
            recording=self.recording,
            robot=self.robot or _beside(self.recording),
            out=out,
            max_scans=self.max_scans,
            disable=self.disable,
        )

    def truth_file(self) -> Path | None:
        """The one that was named or lies there."""
        beside = self.recording.with_suffix(".tum")
        return self.truth or (beside if beside.is_file() else None)


def milliseconds(text: str) -> tuple[float, ...]:
    """`0,100,300` as numbers. Raises InputError."""
    try:
        return tuple(float(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise InputError(f"--delays: expected milliseconds, separated by commas, found {text!r}") from None
