"""The formula of section V-E, and the tables it is fed from."""

from __future__ import annotations

import math

import numpy as np
import pytest

from splitslam.bench import paper
from splitslam.bench.break_even import Cut, break_even_mbps, in_words, total_ms

BREAK_EVEN_MBPS = 0.05  # the paper gives two decimals, of inputs with two decimals


def test_the_papers_inputs_give_its_break_evens():
    made = paper.check()
    assert made == pytest.approx({"case3": 67.85, "case3_fpga": 125.63}, abs=BREAK_EVEN_MBPS)
    assert paper.BREAK_EVEN_MBPS == {"case3": 67.85, "case3_fpga": 125.63}


def test_the_formula_with_the_tables_written_out():
    """Tables III and VI: (39.77 - 5.90) Mbit/s at 10 Hz over (54.72 - 4.80) ms."""
    made, less_mbit = paper.check(), (39.77 - 5.90) / 10
    assert made["case3"] == pytest.approx(less_mbit / ((54.72 - 4.80) * 1e-3))
    assert made["case3_fpga"] == pytest.approx(less_mbit / ((31.76 - 4.80) * 1e-3))


def test_both_cuts_take_equally_long_at_the_break_even():
    near, far = Cut(100.0, 30.0), Cut(4000.0, 5.0)
    even = np.array([break_even_mbps(far, near)])
    assert total_ms(near, even) == pytest.approx(total_ms(far, even))
    assert total_ms(near, even / 2) < total_ms(far, even / 2)
    assert total_ms(near, even * 2) > total_ms(far, even * 2)


def test_less_to_send_in_no_more_time_always_pays_and_more_to_send_never():
    raw = Cut(4000.0, 5.0)
    assert break_even_mbps(raw, Cut(100.0, 5.0)) == math.inf
    assert break_even_mbps(raw, Cut(4000.0, 4.0)) == 0.0
    assert [in_words(x) for x in (math.inf, 0.0, 12.5)] == ["always", "never", 12.5]


def test_table_4_agrees_with_table_3_to_its_rounding():
    case1, case3 = sum(paper.TABLE_3["case1"]), sum(paper.TABLE_3["case3"])
    assert paper.TABLE_4["Walking"][0] == case3
    assert case3 / case1 == pytest.approx(paper.TABLE_4["Walking"][1], abs=0.005)
