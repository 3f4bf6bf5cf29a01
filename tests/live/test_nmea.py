"""What a GNSS receiver says, as fixes with the errors it admits."""

from __future__ import annotations

import random
from collections import Counter
from datetime import UTC, datetime

import numpy as np
import pytest

from edge_agent.sources.live.nmea import NmeaFeed, valid_rmc_ns
from edge_agent.sources.live.sensor_clock import SensorClock, TimeBase
from splitslam.scan import GnssFix
from tests.live.made import gga, gst, nmea, rmc

NOON_NS = int(datetime(2024, 3, 15, 12, 0, 0, tzinfo=UTC).timestamp()) * 10**9


def made_feed() -> tuple[NmeaFeed, Counter[str]]:
    dropped: Counter[str] = Counter()
    return NmeaFeed(SensorClock("gnss"), dropped), dropped


def fixes(feed: NmeaFeed, *texts: str, arrival_ns: int = NOON_NS) -> list[GnssFix]:
    found = [reading.event for text in texts for reading in feed.take(text.encode(), arrival_ns)]
    found += [reading.event for reading in feed.quiet()]
    assert all(isinstance(fix, GnssFix) for fix in found)
    return found  # pyright: ignore[reportReturnType]


def test_a_fix_has_place_height_above_the_ellipsoid_and_utc():
    feed, _ = made_feed()
    (fix,) = fixes(feed, rmc("120000.25", "150324"), gga("120000.25"))
    assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx((48.1173, 11.516667), abs=1e-6)
    assert fix.altitude_m == pytest.approx(545.4 + 46.9)
    assert fix.stamp_ns == NOON_NS + 250_000_000
    assert feed._clock.base is TimeBase.GPS


@pytest.mark.parametrize(("quality", "sigma_m", "status"), [(1, 3.0, 0), (2, 1.0, 1), (4, 0.02, 2), (5, 0.5, 2)])
def test_without_gst_the_error_is_hdop_times_that_of_the_kind_of_fix(quality: int, sigma_m: float, status: int):
    (fix,) = fixes(made_feed()[0], gga("120000", quality, hdop="1.5"))
    assert fix.covariance_enu_m2 is not None
    assert np.sqrt(np.diag(fix.covariance_enu_m2)) == pytest.approx([1.5 * sigma_m, 1.5 * sigma_m, 3.0 * sigma_m])
    assert fix.status == status


def test_gst_says_the_error_and_the_fix_waits_for_it_once_the_receiver_sends_it():
    feed, _ = made_feed()
    fixes(feed, gga("115959"), gst("115959", 9.0, 9.0, 9.0))
    assert not list(feed.take(gga("120000").encode(), NOON_NS))
    (reading,) = feed.take(gst("120000", 0.7, 0.4, 1.1).encode(), NOON_NS)
    assert isinstance(reading.event, GnssFix)
    assert reading.event.covariance_enu_m2 is not None
    assert np.sqrt(np.diag(reading.event.covariance_enu_m2)) == pytest.approx([0.4, 0.7, 1.1])  # east, north, up


def test_no_fix_is_none_and_counted():
    feed, dropped = made_feed()
    dead_reckoning = 6
    assert not fixes(feed, gga("120000", 0), gga("120001", dead_reckoning))
    assert dropped == {"gnss_no_fix": 2}


def test_without_a_date_the_day_is_the_arrivals_also_at_midnight():
    midnight_ns = NOON_NS + 12 * 3600 * 10**9
    feed, _ = made_feed()
    (before,) = fixes(feed, gga("235959.9"), arrival_ns=midnight_ns + 50_000_000)
    (after,) = fixes(feed, gga("000000.1"), arrival_ns=midnight_ns - 50_000_000)
    assert (before.stamp_ns, after.stamp_ns) == (midnight_ns - 100_000_000, midnight_ns + 100_000_000)
    assert feed._clock.base is TimeBase.OWN


def test_sentences_in_pieces_between_other_bytes_and_with_wrong_checksums_are_told_apart():
    feed, _ = made_feed()
    chance = random.Random(2)
    broken = gga("120001").replace("545.4", "645.4")
    ubx = b"\xb5\x62\x01\x07" + chance.randbytes(90).replace(b"$", b"!").replace(b"\n", b"!")
    stream = b"garbage\r\n" + rmc("120000", "150324").encode() + gga("120000").encode() + ubx + broken.encode()
    stream += nmea("GPGSV,1,1,00").encode() + gga("120002").encode() + b"$GPGGA\r\n$\r\n\xff\xfe$,,,*ZZ\r\n"
    found, at = [], 0
    while at < len(stream):
        size = chance.randint(1, 40)
        found += [reading.event for reading in feed.take(stream[at : at + size], NOON_NS)]
        at += size
    assert [fix.stamp_ns - NOON_NS for fix in found if isinstance(fix, GnssFix)] == [0, 2 * 10**9]
    assert feed.counts["checksum"] >= 1
    assert feed.counts["used"] == 3


def test_noise_ends_nothing_and_does_not_pile_up():
    feed, _ = made_feed()
    for seed in range(300):
        list(feed.take(random.Random(seed).randbytes(700).replace(b"\n", b"x"), 0))
    assert len(feed._rest) <= 2048
    assert feed.counts["garbage"] > 10
    assert len(fixes(feed, "\n", gga("120000"))) == 1


def test_the_time_of_an_rmc_counts_only_while_it_is_valid():
    assert valid_rmc_ns(rmc("120000.5", "150324").encode()) == NOON_NS + 500_000_000
    assert valid_rmc_ns(rmc("120000", "150324", valid=False).encode()) is None
    assert valid_rmc_ns(gga("120000").encode()) is None
    assert valid_rmc_ns(b"$GPRMC,,V,,,,,,,,,,N*53\r\n") is None
    assert valid_rmc_ns(b"") is None
