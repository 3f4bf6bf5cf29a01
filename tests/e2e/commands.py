"""The commands as a user calls them: real processes, real gRPC, real recordings."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BIN = Path(sys.executable).parent


@dataclass(frozen=True)
class Run:
    """A finished `splitslam run`: its folder and its report."""

    out: Path
    report: dict[str, Any]

    def evaluation(self, truth: Path, name: str = "trajectory.tum") -> dict[str, Any]:
        """`splitslam eval NAME --truth TRUTH --json`."""
        result = splitslam("eval", str(self.out / name), "--truth", str(truth), "--json")
        assert result.returncode == 0, result.stderr
        return json.loads(result.stdout)


def splitslam(*arguments: str, timeout_s: float = 280.0) -> subprocess.CompletedProcess[str]:
    """Runs the installed command."""
    return subprocess.run([str(BIN / "splitslam"), *arguments], capture_output=True, text=True, timeout=timeout_s)


def run(out: Path, recording: Path, *options: str, robot: Path | None = None) -> Run:
    """`splitslam run RECORDING --robot (the YAML beside it) --out OUT OPTIONS`, which must succeed."""
    robot = robot or recording.with_suffix(".yaml")
    result = splitslam("run", str(recording), "--robot", str(robot), "--out", str(out), *options)
    assert result.returncode == 0, result.stderr + result.stdout
    return Run(out, json.loads((out / "report.json").read_text()))
