"""A Velodyne's position packets say which hour its microseconds belong to, once it is locked."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from edge_agent.sources.live.velodyne import PositionFeed
from tests.live.made import position_packet, rmc

NINE_NS = int(datetime(2024, 3, 15, 9, 0, 0, tzinfo=UTC).timestamp()) * 10**9
MINUTE_US, HOUR_US = 60_000_000, 3_600_000_000


def test_locked_packets_give_utc_of_what_comes_around_them():
    feed = PositionFeed()
    feed.take(position_packet(5 * MINUTE_US + 250_000, rmc("090500", "150324")), arrival_ns=1000)
    assert feed.utc_ns(1000) == NINE_NS + (5 * 60 * 10**9 + 250_000_000)
    assert feed.utc_ns(1000 + 10**6) == NINE_NS + (5 * 60 * 10**9 + 251_000_000)


@pytest.mark.parametrize(
    ("since_hour_us", "said", "expected_s"),
    [(200_000, "085959", 0.2), (HOUR_US - 100_000, "090000", -0.1), (HOUR_US - 100_000, "085959", -0.1)],
)
def test_at_the_full_hour_microseconds_and_sentence_may_be_of_different_hours(
    since_hour_us: int, said: str, expected_s: float
):
    feed = PositionFeed()
    feed.take(position_packet(since_hour_us, rmc(said, "150324")), 0)
    assert feed.utc_ns(0) == NINE_NS + round(expected_s * 1e9)


@pytest.mark.parametrize("pps", [0, 1, 3])
def test_without_a_locked_pulse_nothing_is_said(pps: int):
    feed = PositionFeed()
    feed.take(position_packet(0, rmc("090000", "150324"), pps), 0)
    assert feed.utc_ns(0) is None


def test_without_a_valid_sentence_and_without_packets_for_long_nothing_is_said():
    feed = PositionFeed()
    feed.take(position_packet(0, rmc("090000", "150324", valid=False)), 0)
    assert feed.utc_ns(0) is None
    feed.take(position_packet(0, rmc("090000", "150324")), 0)
    assert feed.utc_ns(2 * 10**9) is not None
    assert feed.utc_ns(4 * 10**9) is None
    feed.take(position_packet(0, ""), 4 * 10**9)
    assert feed.utc_ns(4 * 10**9) is None


def test_packets_of_another_size_are_counted():
    feed = PositionFeed()
    feed.take(b"x" * 511, 0)
    assert feed.counts == {"size": 1}
