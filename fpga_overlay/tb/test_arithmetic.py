"""The arithmetic blocks on Verilator: the cocotb tests of arithmetic.py, each on the module of its name."""

from __future__ import annotations

import pytest

from fpga_overlay.tb.simulation import simulate

BLOCKS = ["float_to_fixed", "isqrt", "cordic_azimuth", "column_of_azimuth", "dot_row"]


@pytest.mark.parametrize("block", BLOCKS)
def test_the_block_is_the_golden_model_to_the_bit(block: str):
    simulate(block, "fpga_overlay.tb.arithmetic", only=rf"\.{block}$")
