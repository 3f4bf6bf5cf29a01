"""The build script, run with stubs in Vivado's place (stub.tcl): its steps, its refusals, its block design.

What Vivado itself makes of it has not been seen.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.systemd.tools import debian

HERE = Path(__file__).parent
OVERLAY = HERE.parents[1]
SUMMARY = """
1. checking no_clock (0)
4. checking unconstrained_internal_endpoints (0)

    WNS(ns)      TNS(ns)  TNS Failing Endpoints  TNS Total Endpoints      WHS(ns)      THS(ns)  THS Failing Endpoints  \
THS Total Endpoints     WPWS(ns)     TPWS(ns)  TPWS Failing Endpoints  TPWS Total Endpoints
    -------      -------  ---------------------  -------------------      -------      -------  ---------------------  \
-------------------     --------     --------  ----------------------  --------------------
      {setup}        0.000                      {failing}                {endpoints}        {hold}        0.000        \
              0                32184        {pulse}        0.000                       0                 13000
"""
OUTPUTS = {"splitslam.bit", "splitslam.hwh", "utilization.rpt", "timing.rpt", "power.rpt"}
STEPS = [
    "version",
    "create_project",
    "read_verilog",
    "update_compile_order",
    "create_bd_design",
    "validate_bd_design",
    "generate_target",
    "make_wrapper",
    "read_xdc",
    "synth_design",
    "opt_design",
    "place_design",
    "phys_opt_design",
    "route_design",
    "report_utilization",
    "report_timing_summary",
    "write_bitstream",
]
IN_PYTHON = (
    "import os, sys, tkinter; tcl = tkinter.Tcl(); tcl.createcommand('exit', lambda code=0: os._exit(int(code))); "
    "tcl.call('source', sys.argv[1])"
)


def summary(
    setup: str = "2.142", hold: str = "0.010", pulse: str = "3.500", failing: int = 0, endpoints: int = 32184
) -> str:
    return SUMMARY.format(setup=setup, hold=hold, pulse=pulse, failing=failing, endpoints=endpoints)


def interpreter() -> list[str]:
    """A Tcl that runs a file: tclsh, Python's own where it was built with one, or Debian's, which root installs."""
    if shell := shutil.which("tclsh"):
        return [shell]
    if importlib.util.find_spec("_tkinter"):
        return [sys.executable, "-c", IN_PYTHON]
    return [debian("tclsh", "tcl")]


@dataclass(frozen=True)
class Build:
    returncode: int
    stderr: str
    log: list[str]
    out: Path

    def calls(self, command: str) -> list[str]:
        return [line for line in self.log if line.split(" ")[0] == command]

    def connections(self) -> set[tuple[str, str]]:
        lines = self.calls("connect_bd_net") + self.calls("connect_bd_intf_net")
        return {(line.split()[1], line.split()[2]) for line in lines}


def build(folder: Path, arguments: str = "", command: list[str] | None = None, **settings: str) -> Build:
    """Runs build.tcl in the stubs, with STUB_* set as `settings` say."""
    log, out = folder / "log", folder / "out"
    defaults = {"VERSION": "2022.1", "SUMMARY": summary(), "BOARDS": "", "WITHOUT": ""}
    environment = {f"STUB_{name}": value for name, value in (defaults | settings).items()}
    environment |= {"STUB_LOG": str(log), "STUB_ARGV": f"-out {out} {arguments}"}
    command = command or [*interpreter(), str(HERE / "stub.tcl")]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, timeout=60)
    return Build(done.returncode, done.stderr, log.read_text().splitlines() if log.exists() else [], out)


def in_order(log: list[str], steps: list[str]) -> bool:
    """Whether the first call of each step comes after that of the step before."""
    names = [line.split(" ")[0] for line in log]
    first = [names.index(step) for step in steps]
    return first == sorted(first)


def test_the_steps_come_in_order_and_leave_every_output(tmp_path: Path) -> None:
    done = build(tmp_path)
    assert done.returncode == 0, done.stderr
    assert in_order(done.log, STEPS)
    assert {path.name for path in done.out.iterdir()} >= OUTPUTS


@pytest.mark.parametrize(
    ("slacks", "named"),
    [
        ({"setup": "-0.001"}, "setup slack -0.001"),
        ({"hold": "-0.050"}, "hold slack -0.050"),
        ({"pulse": "-0.200"}, "pulse-width slack -0.200"),
        ({"failing": 3}, "3 endpoints fail"),
        ({"endpoints": 0}, "no endpoint is timed"),
        ({"setup": "NA"}, "no endpoint is timed"),
    ],
)
def test_timing_that_is_not_met_fails_the_build_and_leaves_no_bitstream(
    tmp_path: Path, slacks: dict[str, str], named: str
) -> None:
    done = build(tmp_path, SUMMARY=summary(**slacks))  # type: ignore[arg-type]
    assert done.returncode == 1
    assert named in done.stderr
    assert (done.out / "timing.rpt").exists()
    assert not (done.out / "splitslam.bit").exists()


def test_timing_that_is_not_known_fails_the_build(tmp_path: Path) -> None:
    assert "no design timing summary" in build(tmp_path, SUMMARY="nothing").stderr
    unclocked = summary().replace("no_clock (0)", "no_clock (12)")
    assert "no_clock 12" in build(tmp_path, SUMMARY=unclocked).stderr


def test_a_bitstream_of_an_earlier_build_does_not_outlive_a_failed_one(tmp_path: Path) -> None:
    assert build(tmp_path).returncode == 0
    assert build(tmp_path, FAILS="route_design").returncode == 1
    assert not (tmp_path / "out" / "splitslam.bit").exists()


@pytest.mark.parametrize("step", ["validate_bd_design", "synth_design", "place_design", "write_bitstream"])
def test_a_step_that_fails_ends_the_build(tmp_path: Path, step: str) -> None:
    done = build(tmp_path, FAILS=step)
    assert done.returncode == 1
    assert f"{step} failed" in done.stderr
    assert done.log[-1].startswith(step)


@pytest.mark.parametrize("lost", ["splitslam.bit", "splitslam.hwh", "power.rpt"])
def test_an_output_that_is_missing_fails_the_build(tmp_path: Path, lost: str) -> None:
    done = build(tmp_path, LOSES=lost)
    assert done.returncode == 1
    assert lost in done.stderr


@pytest.mark.parametrize(
    ("version", "accepted"), [("2021.2", False), ("2022.1", True), ("2024.1.2", True), ("2025.2", True), ("x", False)]
)
def test_versions_from_2022_1_are_accepted(tmp_path: Path, version: str, accepted: bool) -> None:
    assert (build(tmp_path, VERSION=version).returncode == 0) is accepted


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ("-ringz 16", "-ringz"),
        ("-rings 256", "2 to 128"),
        ("-columns 2", "4 to 2048"),
        ("-columns 1800", "a power of two"),
        ("-clock_mhz fast", "a whole number"),
        ("-jobs", "in pairs"),
    ],
)
def test_options_that_make_no_sense_are_refused_by_name(tmp_path: Path, arguments: str, named: str) -> None:
    done = build(tmp_path, arguments)
    assert done.returncode == 1
    assert named in done.stderr
    assert not done.calls("create_project")


def test_rings_columns_and_clock_reach_the_design(tmp_path: Path) -> None:
    log = "\n".join(build(tmp_path, "-rings 16 -columns 1024 -clock_mhz 150").log)
    assert "{CONFIG.RINGS 16 CONFIG.COLUMNS 1024} splitslam_0" in log
    assert "CONFIG.PSU__CRL_APB__PL0_REF_CTRL__FREQMHZ 150" in log


def test_the_board_preset_is_taken_when_it_is_installed_and_the_memory_is_described_when_not(tmp_path: Path) -> None:
    boards = "xilinx.com:zcu104:part0:1.0 xilinx.com:zcu104:part0:1.1"
    with_files, without = build(tmp_path, BOARDS=boards), build(tmp_path)
    assert "set_property board_part xilinx.com:zcu104:part0:1.1 project" in with_files.log
    assert with_files.calls("apply_bd_automation")
    assert not without.calls("apply_bd_automation")
    assert any("CONFIG.PSU__DDRC__DEVICE_CAPACITY {4096 MBits}" in line for line in without.log)


def test_a_vivado_that_cannot_make_the_processing_system_is_told_what_to_install(tmp_path: Path) -> None:
    assert "Zynq UltraScale+ installed" in build(tmp_path, WITHOUT="zynq_ultra_ps_e").stderr
    refused = build(tmp_path, REFUSES="CONFIG.PSU__DDRC__CL")
    assert refused.returncode == 1
    assert "install its ZCU104 board files" in refused.stderr


def test_one_clock_and_its_resets_reach_every_block(tmp_path: Path) -> None:
    made = build(tmp_path).connections()
    clocked = {load for driver, load in made if driver == "zynq_ultra_ps_e_0/pl_clk0"}
    blocks = {"axi_dma_0", "axi_intc_0", "splitslam_0", "control", "read_path", "write_path", "reset_0"}
    assert {load.split("/")[0] for load in clocked} == blocks | {"zynq_ultra_ps_e_0"}
    assert all("clk" in load for load in clocked)
    resets = {load.split("/")[0] for driver, load in made if driver.startswith("reset_0/")}
    assert resets == blocks - {"reset_0", "splitslam_0"}
    assert ("axi_dma_0/mm2s_prmry_reset_out_n", "splitslam_0/aresetn") in made  # the soft reset after a time-out too


def test_data_goes_from_memory_through_the_cores_and_back_by_ports_of_its_own(tmp_path: Path) -> None:
    done = build(tmp_path)
    assert done.connections() >= {
        ("axi_dma_0/M_AXI_MM2S", "read_path/S00_AXI"),
        ("read_path/M00_AXI", "zynq_ultra_ps_e_0/S_AXI_HP0_FPD"),
        ("axi_dma_0/M_AXIS_MM2S", "splitslam_0/s_axis"),
        ("splitslam_0/m_axis", "axi_dma_0/S_AXIS_S2MM"),
        ("axi_dma_0/M_AXI_S2MM", "write_path/S00_AXI"),
        ("write_path/M00_AXI", "zynq_ultra_ps_e_0/S_AXI_HP1_FPD"),
    }
    seen = {line.split()[6]: line.split()[7] for line in done.calls("assign_bd_address")}
    assert seen["axi_dma_0/Data_MM2S"] == "zynq_ultra_ps_e_0/SAXIGP2/HP0_DDR_LOW"
    assert seen["axi_dma_0/Data_S2MM"] == "zynq_ultra_ps_e_0/SAXIGP3/HP1_DDR_LOW"


def test_interrupts_reach_the_processor_with_and_without_a_concatenation(tmp_path: Path) -> None:
    both, one = build(tmp_path).connections(), build(tmp_path, WITHOUT="xlconcat").connections()
    assert both >= {
        ("axi_dma_0/mm2s_introut", "interrupts/In0"),
        ("axi_dma_0/s2mm_introut", "interrupts/In1"),
        ("interrupts/dout", "axi_intc_0/intr"),
    }
    assert ("axi_dma_0/s2mm_introut", "axi_intc_0/intr") in one
    assert ("axi_intc_0/irq", "zynq_ultra_ps_e_0/pl_ps_irq0") in both & one


def test_the_device_of_the_simulation_describes_this_block_design(tmp_path: Path) -> None:
    log = "\n".join(build(tmp_path).log)
    described = ElementTree.parse(OVERLAY / "cosim" / "splitslam.hwh").getroot()
    modules = {module.get("INSTANCE"): module for module in described.iter("MODULE")}
    assert f"{modules['axi_dma_0'].get('VLNV')} axi_dma_0" in log
    assert "-reference splitslam_axis splitslam_0" in log
    assert {"axi_dma_0", "splitslam_0", "zynq_ultra_ps_e_0"} == set(modules)
    for parameter in modules["axi_dma_0"].iter("PARAMETER"):
        name, value = parameter.get("NAME"), parameter.get("VALUE")
        assert name == "c_micro_dma" or f"CONFIG.{name} {value}" in log
    (place,) = described.iter("MEMRANGE")
    assert f"-offset {place.get('BASEVALUE')} -range 64K -target_address_space zynq_ultra_ps_e_0/Data axi_dma_0" in log


def test_two_builds_give_vivado_the_same_commands(tmp_path: Path) -> None:
    assert build(tmp_path).log == build(tmp_path).log


def make(*arguments: str) -> list[str]:
    return ["make", "-C", str(OVERLAY), *arguments]


def test_make_bitstream_hands_its_variables_to_the_script(tmp_path: Path) -> None:
    vivado = tmp_path / "vivado"
    vivado.write_text('#!/bin/sh\necho "$@" > "$(dirname "$0")/arguments"\n')
    vivado.chmod(0o755)
    subprocess.run(make("bitstream", f"VIVADO={vivado}", "RINGS=64"), check=True, capture_output=True, timeout=60)
    given = (tmp_path / "arguments").read_text()
    assert "-source vivado/build.tcl -tclargs -rings 64 -columns 2048" in given
    assert given.strip().endswith("-out build/zcu104-64x2048")


def test_make_bitstream_without_vivado_says_so_in_one_line() -> None:
    done = subprocess.run(make("-s", "VIVADO=no-such-vivado"), capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    first, *rest = done.stderr.strip().splitlines()
    assert "2022.1 to 2025.2" in first
    assert all(line.startswith("make") for line in rest)
