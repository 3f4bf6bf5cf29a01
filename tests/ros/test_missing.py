from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from edge_agent.ros.missing import Missing


def count(stamps_ns: np.ndarray) -> Counter[str]:
    dropped: Counter[str] = Counter()
    missing = Missing("missing", dropped)
    for stamp_ns in stamps_ns.tolist():
        missing.saw(stamp_ns)
    return +dropped


def stamps(count: int, rate_hz: float, jitter_s: float = 0.0) -> np.ndarray:
    noise_s = np.random.default_rng(1).uniform(-jitter_s, jitter_s, count)
    return (1_700_000_000_000_000_000 + 1e9 * (np.arange(count) / rate_hz + noise_s)).astype(np.int64)


@pytest.mark.parametrize(("rate_hz", "jitter_s"), [(10.0, 0.01), (500.0, 0.0002), (97.3, 0.001)])
def test_a_stream_with_its_usual_jitter_misses_nothing(rate_hz: float, jitter_s: float):
    assert count(stamps(1000, rate_hz, jitter_s)) == {}


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3])
def test_every_message_that_does_not_come_is_counted_also_before_the_rate_is_known(share: float):
    whole = stamps(1000, 10.0, 0.005)
    keep = np.random.default_rng(2).random(1000) >= share
    keep[[0, -1]] = True
    assert count(whole[keep]) == {"missing": 1000 - int(keep.sum())}


def test_a_sensor_that_stops_for_a_while_has_lost_nothing_on_the_way():
    whole = stamps(400, 10.0)
    assert count(np.delete(whole, slice(200, 260))) == {}


def test_stamps_that_are_set_back_or_come_twice_are_nobodys_loss():
    whole = stamps(400, 10.0)
    whole[200:] -= 3_600_000_000_000
    assert count(np.repeat(whole, 2)) == {}
