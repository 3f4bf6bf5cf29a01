from __future__ import annotations

import random

import pytest

from edge_agent.backoff import Backoff, welcome_timeout_s


class TopOfRange(random.Random):
    def uniform(self, a: float, b: float) -> float:
        assert a == 0.0
        return b


def test_the_first_retry_is_immediate_then_the_cap_doubles_to_its_limit():
    backoff = Backoff(0.1, 2.0, TopOfRange())
    assert [round(backoff.next_s(), 3) for _ in range(8)] == [0.0, 0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0]
    backoff.reset()
    assert backoff.next_s() == 0.0


def test_a_day_of_retries_does_not_overflow():
    backoff = Backoff(0.1, 2.0)
    assert all(0.0 <= backoff.next_s() <= 2.0 for _ in range(5000))


@pytest.mark.parametrize(("failures", "expected_s"), [(0, 0.5), (1, 0.5), (2, 1.0), (3, 2.0), (4, 4.0), (99, 4.0)])
def test_the_welcome_time_out_is_short_twice_and_then_grows(failures: int, expected_s: float):
    assert welcome_timeout_s(0.5, 4.0, failures) == expected_s
