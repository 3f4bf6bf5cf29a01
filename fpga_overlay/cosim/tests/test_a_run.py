"""Recordings through `splitslam run` beside the board's PYNQ and its pins: this environment has them."""

from __future__ import annotations

import importlib.metadata
import os
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.e2e.commands import run
from tests.missing import missing
from tests.tolerances import COSIM_RUN_M

DATA = Path(os.environ.get("SPLITSLAM_DATA") or ROOT.parent / "shared" / "data")


def recording(name: str) -> Path:
    path = DATA / f"{name}.bag"
    if not path.is_file():
        missing(f"no recording {path} (set SPLITSLAM_DATA)")
    return path


def positions(path: Path) -> np.ndarray:
    return np.loadtxt(path)[:, 1:4]


def test_this_environment_is_the_board_s_pynq_with_its_pins() -> None:
    versions = {name: importlib.metadata.version(name) for name in ("pynq", "grpcio", "grpcio-tools", "numpy")}
    assert versions["pynq"] == "4.0.0"
    assert versions["grpcio"] == versions["grpcio-tools"] == "1.64.0"
    assert int(versions["numpy"].split(".")[0]) < 2


@pytest.mark.parametrize("name", ["yard1/yard1", "kitti_0005/kitti_0005_ring16"])
def test_twenty_scans_deskewed_by_the_cores_give_the_trajectory_of_the_cpu(name: str, tmp_path: Path) -> None:
    """Standing and, in the second one, driving from the start."""
    options = ["--max-scans", "20", "--disable", "gnss"]
    on_cpu = run(tmp_path / "cpu", recording(name), *options, "--deskew", "cpu")
    by_rtl = run(tmp_path / "cosim", recording(name), *options, "--deskew", "cosim")
    for made in (on_cpu, by_rtl):
        assert made.report["scans"]["mapped"] == 20
    frames = [made.report["uplink"]["payload_sha256"] for made in (on_cpu, by_rtl)]
    assert frames[0] == frames[1]  # to the bit, so that the trajectories can only be one
    for file in ("trajectory.tum", "odom.tum"):
        difference = np.linalg.norm(positions(on_cpu.out / file) - positions(by_rtl.out / file), axis=1)
        assert difference.max() <= COSIM_RUN_M
