from __future__ import annotations

import pytest

from edge_agent.rate_grid import RateGrid

STEP_NS = 2_000_000


@pytest.mark.parametrize("rate_hz", [50.0, 30.0, 77.0, 500.0])
def test_the_mean_rate_is_the_wanted_one_also_when_it_does_not_divide_that_of_the_stream(rate_hz: float):
    grid = RateGrid(rate_hz)
    due = sum(grid.due(k * STEP_NS) for k in range(5000))
    assert due == pytest.approx(10.0 * rate_hz, rel=0.01)


def test_without_a_rate_every_sample_is_due():
    grid = RateGrid(0.0)
    assert all(grid.due(k * STEP_NS) for k in range(100))


def test_a_clock_that_is_set_back_does_not_silence_the_stream():
    grid = RateGrid(50.0)
    assert grid.due(10**18)
    assert grid.due(10**9)
    assert not grid.due(10**9 + STEP_NS)


def test_after_a_gap_the_samples_that_were_missed_are_not_made_up_for():
    grid = RateGrid(50.0)
    grid.due(0)
    assert grid.due(10**9)
    assert not grid.due(10**9 + STEP_NS)
