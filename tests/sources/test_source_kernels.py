"""What a sequencer asks of each message, against plain numpy; without the JIT too."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.sources import _kernels as kernels


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 10.1, -10.1])
def test_one_value_that_is_too_large_or_no_number_is_found_wherever_it_is(kind: type, wrong: float):
    values = np.random.default_rng(1).normal(size=(50, 3)).astype(kind)
    assert kernels.all_within(values, 10.0)
    assert kernels.all_within(values[:0], 10.0)
    for row, column in ((0, 0), (17, 1), (49, 2)):
        spoilt = values.copy()
        spoilt[row, column] = wrong
        assert not kernels.all_within(spoilt, 10.0)
        assert kernels.all_within(spoilt, np.finfo(kind).max) == bool(np.isfinite(wrong))


def test_time_goes_on_while_every_step_is_ahead_and_none_too_long():
    rng = np.random.default_rng(2)
    for _ in range(200):
        stamps_ns = 10**18 + np.cumsum(rng.integers(-1, 12, rng.integers(1, 6)))
        step_ns = np.diff(stamps_ns)
        assert kernels.goes_on(stamps_ns, 10) == bool(((step_ns > 0) & (step_ns <= 10)).all())
