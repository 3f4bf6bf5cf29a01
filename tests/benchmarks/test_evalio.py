"""This system as a pipeline of evalio: a real run of evalio's own classes, held against the run from the file."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from splitslam.bench.in_one_process import run_both
from splitslam.evaluate import evaluate
from splitslam.tum import read_tum
from tests.conftest import ROOT
from tests.missing import missing
from tests.tolerances import EVALIO_ATE_OFF_M, YARD1_ONLINE_ATE_M

# What its types and pipelines import; all that it declares are for its data sets, and pin what we use otherwise.
PACKAGES = ("evalio==0.6.1", "asteval", "tqdm")
SCANS = 70


@pytest.fixture(scope="module")
def evalio(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder to import it from."""
    folder = tmp_path_factory.mktemp("evalio")
    command = [sys.executable, "-m", "pip", "install", "-qq", "--no-deps", "--target", str(folder), *PACKAGES]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    if done.returncode != 0:
        missing(f"evalio cannot be installed: {done.stderr.strip()[-300:]}")
    return folder


def test_a_drive_through_evalio_is_as_good_as_from_the_file(evalio: Path, shared_data: Path, tmp_path: Path) -> None:
    yard1 = shared_data / "yard1"
    bag, robot, out = yard1 / "yard1.bag", yard1 / "yard1.yaml", tmp_path / "poses.tum"
    command = [sys.executable, str(ROOT / "tests" / "benchmarks" / "evalio_drive.py"), bag, robot, SCANS, out]
    environment = {**os.environ, "PYTHONPATH": f"{evalio}:{ROOT}"}
    done = subprocess.run([str(part) for part in command], env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr[-2000:]
    truth = read_tum(yard1 / "yard1.tum")
    told = evaluate(read_tum(out), truth)
    from_file = evaluate(run_both(bag, robot, max_scans=SCANS, disable=("gnss",)).online(), truth)
    assert told.n == from_file.n == SCANS
    assert told.ate_m < YARD1_ONLINE_ATE_M
    assert abs(told.ate_m - from_file.ate_m) < EVALIO_ATE_OFF_M
