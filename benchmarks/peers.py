"""Runs a peer on a recording: dump, subprocess in .venv-bench, poses back."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splitslam import se3
from splitslam.errors import InputError
from splitslam.tum import Trajectory

ROOT = Path(__file__).resolve().parent.parent
PYTHON = ROOT / ".venv-bench" / "bin" / "python"
PEERS = ("lio_sam", "dlio", "kiss_icp", "rko_lio")
_TIMEOUT_S = 1800
# One thread each: the figures are for one core, and sums in a fixed order repeat.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "TBB_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


@dataclass(frozen=True, slots=True, eq=False)
class PeerRun:
    """trajectory: T_world_lidar as the peer stamps it, None when it gave up.

    cpu_ms: mean CPU time a scan of all its threads; prepare_ms: of making its input besides, no work of the peer.
    ended: how the process ended: "" or the last line of its errors.
    """

    trajectory: Trajectory | None
    cpu_ms: float | None
    ended: str
    prepare_ms: float | None = None


def check_peers_installed() -> None:
    """Raises InputError when the peers' environment is missing."""
    if not PYTHON.exists():
        raise InputError(f"{PYTHON}: the peers are not installed: make bench-setup (or leave them out: --systems ours)")


def run_peer(name: str, dump: Path, work: Path) -> PeerRun:
    """Runs peer `name` (of PEERS) on a dump (benchmarks/dump.py); `work`: where its files go.

    A peer that crashes is no error: it has no trajectory.
    """
    out, log = work / f"{name}.npz", work / f"{name}.log"
    out.unlink(missing_ok=True)
    command = [PYTHON, ROOT / "benchmarks" / "peer_runner.py", name, dump, out]
    with log.open("w") as file:
        try:
            code = subprocess.run(
                [str(part) for part in command],
                stdout=file,
                stderr=subprocess.STDOUT,
                timeout=_TIMEOUT_S,
                env={**os.environ, **_ONE_THREAD},
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            return PeerRun(None, None, f"still running after {_TIMEOUT_S} s")
    if code != 0 or not out.exists():
        lines = log.read_text(errors="replace").strip().splitlines() or [""]
        return PeerRun(None, None, f"exit code {code}: {lines[-1][:200]}")
    with np.load(out) as poses:
        T = poses["T_world_lidar"]
        quats = np.array([se3.quat_from_matrix(R) for R in T[:, :3, :3]]).reshape(-1, 4)
        trajectory = Trajectory(poses["stamps_ns"].astype(np.int64), T[:, :3, 3].copy(), quats)
        cpu_ms, prepare_ms = (float(poses[key].mean() * 1e3) for key in ("cpu_s", "prepare_s"))
        return PeerRun(trajectory if len(T) else None, cpu_ms, "", prepare_ms)
