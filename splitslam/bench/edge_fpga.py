"""The edge with the cores behind its driver: the overlay's own report, in the overlay's own environment."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from splitslam.bench.edge_result import STAGES, Accelerated
from splitslam.run.processes import RunFailedError

ROOT = Path(__file__).resolve().parents[2]
PYTHON = ROOT / ".venv-fpga" / "bin" / "python"
MEASURED = "clocks of the RTL at 100 MHz + CPU time of the rest here; never run on a board"
MISSING = "not measured: the overlay's environment is not here (in a checkout: make fpga-setup)"
_TIMEOUT_S = 3600


def installed() -> bool:
    """Whether there is a checkout with the overlay and its environment."""
    return PYTHON.exists() and (ROOT / "fpga_overlay" / "report").is_dir()


def accelerated(recording: Path, robot: Path, max_scans: int | None) -> Accelerated:
    """All scans but the first, which finds the logic just reset.

    Raises RunFailedError with the last line of the report's errors: a sensor that the logic cannot hold, no compiler.
    """
    with tempfile.TemporaryDirectory(prefix="edge-") as work:
        out = Path(work) / "edge.json"
        command = [PYTHON, "-m", "fpga_overlay.report.edge", recording.resolve(), robot.resolve(), out]
        command += [] if max_scans is None else [max_scans]
        done = subprocess.run(
            [str(part) for part in command], capture_output=True, text=True, cwd=ROOT, timeout=_TIMEOUT_S, check=False
        )
        if done.returncode != 0:
            said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
            raise RunFailedError(f"with the cores: {said[-1]}")
        found = json.loads(out.read_text(encoding="utf-8"))
    if found["fallbacks"]:
        raise RunFailedError(f"with the cores: {found['fallbacks']} scans were done on the processor")
    rows = found["scans"][1:] or found["scans"]
    return Accelerated(
        ps_ms={stage: np.array([row["ps_cpu_ms"][stage] for row in rows]) for stage in (*STAGES, "total")},
        cores_ms=np.array([row["cores_ms"] for row in rows]),
        image_board_ms=np.array([row["image_on_board_ms"] for row in rows]),
    )
