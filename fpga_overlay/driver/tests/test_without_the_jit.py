"""The driver's kernels pass their tests as plain Python too: what numba compiles is what the source says."""

from __future__ import annotations

import os
import subprocess
import sys

from tests.conftest import ROOT


def test_the_kernels_tests_pass_without_the_jit() -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider"]
    command += ["fpga_overlay/driver/tests/test_kernels.py"]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stdout[-3000:]
