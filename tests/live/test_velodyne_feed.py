"""Packets at a Velodyne's data port: what is not the sensor's is counted, what is becomes scans in its time."""

from __future__ import annotations

import logging
import struct
from collections import Counter
from datetime import UTC, datetime

import numpy as np
import pytest

from edge_agent.sources import Counts
from edge_agent.sources.live.sensor_clock import SensorClock, TimeBase
from edge_agent.sources.live.velodyne import PositionFeed, VelodyneFeed
from splitslam.scan import Scan
from tests.live import wire
from tests.live.made import STEP_US, data_packet, position_packet, rmc
from tests.logs.said import said

NINE_NS = int(datetime(2024, 3, 15, 9, 0, 0, tzinfo=UTC).timestamp()) * 10**9
HDL32 = 0x21
DUAL = 0x39


class Fed:
    """A feed, and the scans that came out of it."""

    def __init__(self) -> None:
        self.clock, self.position = SensorClock("lidar"), PositionFeed()
        self.feed = VelodyneFeed(wire.velodyne_robot("vlp16"), self.clock, self.position, Counts(), Counter())
        self.scans: list[Scan] = []

    def take(self, data: bytes, arrival_ns: int) -> None:
        readings = list(self.feed.take(data, arrival_ns))
        self.scans += [reading.event for reading in readings if isinstance(reading.event, Scan)]

    def counts(self) -> dict[str, int]:
        return {result: count for result, count in self.feed.counts.items() if count}


def test_short_foreign_and_other_sensors_packets_are_counted_by_reason_and_another_sensor_is_said_once(
    caplog: pytest.LogCaptureFixture,
):
    fed = Fed()
    with caplog.at_level(logging.ERROR):
        for k in range(3):
            fed.take(data_packet(k, code=HDL32), NINE_NS)
            fed.take(data_packet(k)[:-1], NINE_NS)
            fed.take(b"\x00" * 1206, NINE_NS)
            fed.take(b"", NINE_NS)
    assert fed.counts() == {"model": 3, "size": 6, "foreign": 3}
    assert [(event, fields["found"]) for event, fields in said(caplog)] == [("packets of another lidar", "hdl32")]


def test_scans_are_stamped_by_their_first_firing_and_end_with_their_last():
    fed = Fed()
    for k in range(240):
        fed.take(data_packet(k, 1e6), NINE_NS + 10**9 + round(k * STEP_US * 1000))
    first, second = fed.scans[:2]
    assert first.stamp_ns == NINE_NS + 10**9 + int(76 * STEP_US) * 1000
    assert first.end_ns - first.stamp_ns == pytest.approx(75 * STEP_US * 1000, abs=60_000)
    assert 0 < second.stamp_ns - first.end_ns < 60_000  # the next firing
    assert len(first) == 75 * 24 * 16


def test_when_the_pulse_locks_the_hour_is_that_of_the_sentence_and_the_clock_begins_anew():
    fed = Fed()
    wrong_ns = NINE_NS + 5 * 3600 * 10**9 + 10**9  # our clock is five hours ahead
    for k in range(200):
        fed.take(data_packet(k, 1e6), wrong_ns + round(k * STEP_US * 1000))
    assert fed.clock.base is TimeBase.OWN
    age = fed.clock.age
    arrival_ns = wrong_ns + round(200 * STEP_US * 1000)
    fed.position.take(position_packet(1_000_000 + int(200 * STEP_US), rmc("090001", "150324")), arrival_ns)
    for k in range(200, 440):
        fed.take(data_packet(k, 1e6), wrong_ns + round(k * STEP_US * 1000))
    assert fed.clock.base is TimeBase.GPS
    assert fed.clock.age == age + 1
    assert fed.scans[0].stamp_ns > wrong_ns
    assert abs(fed.scans[-1].stamp_ns - NINE_NS - 10**9) < 10**9
    assert fed.feed.counts["lost"] == fed.feed.counts["late"] == 0


def test_in_dual_return_the_strongest_is_kept_and_no_packet_seems_lost():
    fed = Fed()
    for k in range(400):
        packet = bytearray(data_packet(k, 1e6))
        packet[1204] = DUAL
        packet[1200:1204] = struct.pack("<I", int(1e6 + k * STEP_US / 2))
        for block in range(12):  # pairs of one azimuth, the odd ones nearer and stronger
            azimuth = int(36_000 / 150.8 * (k + (block // 2) / 6)) % 36_000
            packet[100 * block + 2 : 100 * block + 4] = struct.pack("<H", azimuth)
            for channel in range(32):
                at = 100 * block + 4 + 3 * channel
                packet[at : at + 3] = struct.pack("<HB", 1000 if block % 2 else 2500, 90 if block % 2 else 10)
        fed.take(bytes(packet), NINE_NS + round(k * STEP_US * 500))
    assert fed.feed.counts["lost"] == 0
    scan = fed.scans[0]
    ranges_m = np.linalg.norm(scan.points_lidar, axis=1)
    np.testing.assert_allclose(ranges_m, 2.0, atol=0.01)
    assert 140 * 12 * 16 < len(scan) < 152 * 12 * 16
