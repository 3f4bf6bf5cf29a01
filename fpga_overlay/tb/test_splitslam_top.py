"""Both cores chained (rtl/splitslam_top.sv): the cocotb tests of splitslam_top.py."""

from __future__ import annotations

from fpga_overlay.tb.simulation import simulate


def test_both_cores_together_are_the_golden_model_to_the_bit() -> None:
    simulate("splitslam_top", "fpga_overlay.tb.splitslam_top", {"RINGS": 4, "COLUMNS": 64})
