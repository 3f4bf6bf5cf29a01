"""The cores' resources by Yosys, against their ceilings and against the report that is kept."""

from __future__ import annotations

import json
from dataclasses import asdict, fields

import pytest

from fpga_overlay.syn import report, yosys
from tests.missing import missing

THERE = [core for core in report.CORES if (yosys.RTL / f"{core}.sv").exists()]


@pytest.mark.parametrize("core", [core for core in THERE if core in report.CEILINGS])
def test_a_core_takes_no_more_than_its_ceiling(core: str):
    found, ceiling = asdict(yosys.synthesise(core)), asdict(report.CEILINGS[core])
    over = {name: (found[name], most) for name, most in ceiling.items() if found[name] > most}
    assert not over, f"{core}: (found, ceiling) {over}"


def test_the_report_that_is_kept_is_what_comes_out_today():
    kept = json.loads(report.REPORT.read_text())
    if kept["tool"] != yosys.TOOL:
        missing(f"kept with {kept['tool']}, here is {yosys.TOOL}: run `python -m fpga_overlay.syn.report --write`")
    assert kept == report.report(), "run `python -m fpga_overlay.syn.report --write`"


def test_memories_and_shift_registers_count_as_the_luts_that_hold_them():
    cells = {"LUT6": 3, "INV": 1, "RAM64M8": 2, "SRLC32E": 5, "CARRY4": 9, "RAMB18E2": 3, "RAMB36E2": 1, "FDSE": 2}
    assert yosys.count(cells) == yosys.Resources(dsp=0, bram36=2.5, uram=0, lut=3 + 1 + 16 + 5, ff=2)
    assert [f.name for f in fields(yosys.Resources)] == ["dsp", "bram36", "uram", "lut", "ff"]


def test_a_cell_of_unknown_cost_is_an_error():
    with pytest.raises(ValueError, match="PCIE40E4"):
        yosys.count({"LUT6": 1, "PCIE40E4": 1})
