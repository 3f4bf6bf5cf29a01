"""The deskew core on Verilator: the cocotb tests of deskew_core.py."""

from __future__ import annotations

from fpga_overlay.tb.simulation import simulate


def test_the_deskew_core_is_the_golden_model_to_the_bit():
    simulate("deskew_core", "fpga_overlay.tb.deskew_core")
