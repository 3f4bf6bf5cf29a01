"""The feature core (rtl/feature_core.sv) against the golden model, bit for bit."""

from __future__ import annotations

import pytest

from fpga_overlay.tb.simulation import simulate

BENCH = "fpga_overlay.tb.feature_core"
SIZES = {"one bank": (4, 32, 4096), "four banks": (8, 64, 64), "sixteen banks": (2, 256, 16)}


@pytest.mark.parametrize("size", SIZES)
def test_the_feature_core_computes_what_the_golden_model_does(size: str) -> None:
    rings, columns, bank_words = SIZES[size]
    simulate("feature_core", BENCH, {"RINGS": rings, "COLUMNS": columns, "BANK_WORDS": bank_words})
