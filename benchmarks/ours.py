"""Runs `splitslam run` on a recording: the real programs, and features that have gone over the wire."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.consistency import Doubt, read_doubt
from benchmarks.drives import SPLITSLAM, Files
from splitslam.tum import Trajectory, read_tum

_TIMEOUT_S = 3600


@dataclass(frozen=True, slots=True, eq=False)
class OurRun:
    """What a run wrote. trajectory: final; online: as answered at the time. None in all of it: `ended` says why."""

    trajectory: Trajectory | None
    online: Trajectory | None
    doubt: Doubt | None
    report: dict[str, Any]
    ended: str = ""


def run_ours(files: Files, out: Path, *, disable: tuple[str, ...], deskew: str, max_scans: int | None) -> OurRun:
    """One run in lockstep with the defaults; `out` is removed again. A run that fails is a result, not an error."""
    command = [str(SPLITSLAM), "run", str(files.bag), "--robot", str(files.robot), "--out", str(out), "--json"]
    command += ["--deskew", deskew]
    command += ["--disable", ",".join(disable)] if disable else []
    command += ["--max-scans", str(max_scans)] if max_scans is not None else []
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
        if result.returncode != 0:
            return OurRun(None, None, None, {}, (result.stderr.strip() or "failed").splitlines()[-1])
        return OurRun(
            trajectory=read_tum(out / "trajectory.tum"),
            online=read_tum(out / "online.tum"),
            doubt=read_doubt(out / "online_covariance.csv"),
            report=json.loads((out / "report.json").read_text()),
        )
    except subprocess.TimeoutExpired:
        return OurRun(None, None, None, {}, f"still running after {_TIMEOUT_S} s")
    finally:
        shutil.rmtree(out, ignore_errors=True)
