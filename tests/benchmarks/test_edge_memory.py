from __future__ import annotations

import pytest

from benchmarks.edge_memory import verdict


def test_growth_is_told_once_all_is_settled_and_the_largest_is_that_of_the_last_minute():
    samples = [(10.0 * k, 100.0 + 10.0 * min(k, 12) + (0.2 / 6.0) * k) for k in range(61)]
    found = verdict(samples)
    assert found["growth_mb_a_minute"] == pytest.approx(0.2, abs=1e-6)
    assert found["rss_mb"] == pytest.approx(samples[-1][1])
