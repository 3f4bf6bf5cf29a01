"""`splitslam sim`: makes a drive, and lists what there is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from splitslam.errors import InputError
from splitslam.sim.drives import DRIVES
from splitslam.sim.faults import FAULTS, parse
from splitslam.sim.recorder import SimRecording, simulate
from splitslam.sim.spec import DriveSpec, WheelSpec

MIN_S = 1.0


def drive_spec(name: str, *, seed: int, perturb: str, seconds: float | None, gnss: bool, wheels: bool) -> DriveSpec:
    """The drive as the command line asks for it. Raises InputError for what is not known or not possible."""
    if name not in DRIVES:
        raise InputError(f"drive {name!r} is not known: expected one of {', '.join(DRIVES)}")
    spec = DRIVES[name]
    if seconds is not None and not MIN_S <= seconds <= spec.duration_s:
        raise InputError(f"--seconds: expected {MIN_S:g} to {spec.duration_s:g} for {name}, found {seconds:g}")
    if wheels and spec.path.gait > 0.0:
        raise InputError(f"--wheels: expected a drive of a vehicle, {name} is on foot")
    return replace(
        spec,
        seed=seed,
        duration_s=spec.duration_s if seconds is None else seconds,
        gnss=spec.gnss if gnss else None,
        wheels=WheelSpec() if wheels else None,
        perturbations=parse(perturb),
    )


def make(spec: DriveSpec, out: Path, progress: Callable[[int, int], None]) -> SimRecording:
    """Makes the drive in `out`. Raises InputError when the folder cannot be written."""
    try:
        return simulate(spec, out, progress)
    except OSError as error:
        raise InputError(f"--out {out}: expected a folder that can be written ({error.strerror})") from error


def listing() -> str:
    """All drives and perturbations, a line each."""
    lines = ["drives:"]
    lines += [f"  {name:<15} {spec.duration_s:6.0f} s  {spec.what}" for name, spec in DRIVES.items()]
    lines += ["perturbations (--perturb NAME=STRENGTH,...):"]
    for name, fault in FAULTS.items():
        strengths = ", ".join(f"{value:g}" for value in fault.strengths)
        middle = f"; middle {fault.middle:g}" if fault.middle else ""
        lines.append(f"  {name:<17} {fault.what} [{fault.unit}: {strengths}{middle}]")
    return "\n".join(lines)
