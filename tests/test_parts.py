"""`make test` that is ended leaves nothing behind that works on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from splitslam.stack.process import wait_until
from tests.conftest import ROOT
from tests.map_service.harness import running

# A part of `make test` and what it has started, each with a file by its number; "deaf" heeds nothing but SIGKILL.
PART = """
import os, pathlib, signal, subprocess, sys, time
folder, manner, depth = sys.argv[1:4]
if manner == "deaf":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
if depth == "0":
    subprocess.Popen([sys.executable, *sys.orig_argv[1:3], folder, manner, "1"])
pathlib.Path(folder, str(os.getpid())).touch()
time.sleep(600)
"""
MAIN = """
import sys
from tests import __main__ as whole, parts
part, folder, manner, patience_s = sys.argv[1:]
whole._PYTEST = sys.executable, "-c", part, folder, manner, "0"
whole._KERNELS = ()
parts._PATIENCE_S = float(patience_s)
sys.argv[1:] = []
sys.exit(whole.main())
"""


@pytest.mark.parametrize(
    ("number", "manner", "patience_s"),
    [
        (signal.SIGTERM, "polite", 60.0),
        (signal.SIGINT, "polite", 60.0),
        (signal.SIGTERM, "deaf", 0.2),
    ],
)
def test_a_signal_ends_every_part_and_what_it_has_started(
    tmp_path: Path, number: signal.Signals, manner: str, patience_s: float
) -> None:
    programs, pids = tmp_path / "bin", tmp_path / "pids"
    programs.mkdir()
    pids.mkdir()
    make = programs / "make"
    make.write_text(f"#!/bin/sh\nexec {sys.executable} -c '{PART}' {pids} {manner} 0\n")
    make.chmod(0o755)
    command = [sys.executable, "-c", MAIN, PART, str(pids), manner, str(patience_s)]
    environment = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"}
    with subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE) as whole:
        try:
            wait_until(lambda: len(list(pids.iterdir())) == 6, 30.0, "three parts and what each has started")
            whole.send_signal(number)
            assert whole.wait(60.0) == 128 + number
            left = [int(path.name) for path in pids.iterdir() if running(int(path.name))]
            assert left == []
        finally:
            for path in pids.iterdir():
                if running(int(path.name)):
                    os.kill(int(path.name), signal.SIGKILL)
