"""Every package of the edge has a wheel for aarch64 and Python 3.12, which is what a PYNQ 4.0 image runs."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.conftest import ROOT

PLATFORMS = ("manylinux_2_28_aarch64", "manylinux_2_17_aarch64", "manylinux2014_aarch64")
# pynq 4.0.0 pins these beside us on the board.
BOARD_PINS = ["grpcio==1.64.0", "numpy<2"]


@pytest.mark.parametrize("pins", [[], BOARD_PINS], ids=["newest", "beside pynq 4.0"])
def test_every_edge_dependency_resolves_to_wheels_for_aarch64(pins: list[str], tmp_path: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = project["dependencies"] + project["optional-dependencies"]["edge"]
    report = tmp_path / "report.json"
    # --dry-run reads the wheels' metadata only.
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "-qq"]
    command += ["--target", str(tmp_path / "nothing"), "--report", str(report)]
    command += ["--only-binary=:all:", "--python-version", "3.12"]
    command += [flag for platform in PLATFORMS for flag in ("--platform", platform)]
    done = subprocess.run([*command, *asked, *pins], capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr[-2000:]
    wheels = [entry["download_info"]["url"].rpartition("/")[2] for entry in json.loads(report.read_text())["install"]]
    assert len(wheels) >= len(asked)
    foreign = [wheel for wheel in wheels if not wheel.endswith("-any.whl") and "aarch64" not in wheel]
    assert not foreign
