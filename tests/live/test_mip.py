"""MicroStrain's byte stream becomes samples, however it is read and whatever lies between its packets."""

from __future__ import annotations

import itertools
import random
import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from edge_agent.sources.live.mip import MipFeed
from edge_agent.sources.live.sensor_clock import SensorClock, TimeBase
from edge_agent.sources.source import Counts
from splitslam.scan import ImuSamples
from tests.live.made import mip_packet, mip_sample, pieces

PACKETS, SAMPLES = 8384, 4473  # of the recorded stream, counted by its makers


def made_feed() -> MipFeed:
    return MipFeed(SensorClock("imu"), 0, Counts(), Counter())


def fed(feed: MipFeed, chunks: list[bytes]) -> ImuSamples:
    """All samples of the chunks, which come 8 ms apart."""
    runs = [
        reading.event
        for k, chunk in enumerate(chunks)
        for reading in feed.take(chunk, 10**18 + k * 8_000_000)
        if isinstance(reading.event, ImuSamples)
    ]
    return ImuSamples.joined(runs)


@pytest.mark.parametrize("largest", [1, 7, 64, 4096])
def test_every_packet_of_a_recorded_stream_is_decoded_or_counted_however_it_is_read(largest: int, shared_data: Path):
    stream = (shared_data / "fixtures/imu/microstrain_mip.bin").read_bytes()
    chance, feed = random.Random(3), made_feed()
    samples = fed(feed, list(pieces(stream, (chance.randint(1, largest) for _ in itertools.count()))))
    assert feed.counts["used"] == len(samples) == SAMPLES
    assert feed.counts["used"] + feed.counts["unused"] == PACKETS
    assert feed.counts["checksum"] == feed.counts["garbage"] == 0


def test_the_recorded_samples_are_those_of_a_sensor_on_earth_at_125_hz(shared_data: Path):
    samples = fed(made_feed(), [(shared_data / "fixtures/imu/microstrain_mip.bin").read_bytes()])
    assert np.median(np.linalg.norm(samples.accel_mps2, axis=1)) == pytest.approx(9.8, abs=0.3)
    assert np.median(np.diff(samples.stamps_ns)) == 8_000_000
    assert (np.diff(samples.stamps_ns) > 0).all()
    # the first packet, read by hand from its bytes
    assert samples.accel_mps2[0] / 9.80665 == pytest.approx(
        struct.unpack(">3f", bytes.fromhex("3c8eaf72bbda6818bf7c52e8"))
    )
    assert samples.gyro_radps[0] == pytest.approx(struct.unpack(">3f", bytes.fromhex("bb469ccf39a34c8bbb8be12f")))
    assert int(samples.stamps_ns[0]) == 0x41D8BAE040


def test_units_are_si():
    (reading,) = made_feed().take(mip_sample((0.5, 0.0, -1.0), (0.1, 0.2, -0.3), reference_ns=5), 0)
    assert isinstance(reading.event, ImuSamples)
    assert reading.event.accel_mps2[0] == pytest.approx([0.5 * 9.80665, 0.0, -9.80665])
    assert reading.event.gyro_radps[0] == pytest.approx([0.1, 0.2, -0.3])


def test_garbage_broken_packets_and_chance_sync_bytes_cost_nothing_but_themselves():
    whole = [mip_sample(reference_ns=k * 8_000_000) for k in range(20)]
    broken = bytearray(whole[5])
    broken[9] ^= 0x10
    stream = (
        b"\x00u\x75\x65"
        + whole[0]
        + b"garbage"
        + whole[1]
        + bytes(broken)
        + b"\x75\x65\x80\xff"
        + whole[2]
        + whole[3][:-7]
    )
    stream += b"".join(whole[6:])
    feed = made_feed()
    samples = fed(feed, [stream + bytes(300)])
    assert samples.stamps_ns.tolist() == [k * 8_000_000 for k in (0, 1, 2, *range(6, 20))]
    assert feed.counts["used"] == 17
    assert feed.counts["checksum"] >= 3


@pytest.mark.parametrize("place", [3, 9, -2, -1], ids=["length", "data", "first sum", "second sum"])
def test_a_byte_that_is_wrong_anywhere_costs_its_packet_alone(place: int):
    packets = [mip_sample(reference_ns=k) for k in range(3)]
    broken = bytearray(packets[1])
    broken[place] ^= 1
    feed = made_feed()
    assert fed(feed, [packets[0] + bytes(broken) + packets[2] + bytes(300)]).stamps_ns.tolist() == [0, 2]
    assert feed.counts["checksum"] == 1


def test_a_stream_of_noise_ends_nothing_and_is_counted():
    feed = made_feed()
    noise = random.Random(1).randbytes(200_000)
    assert not [reading for chunk in pieces(noise, itertools.repeat(997)) for reading in feed.take(chunk, 0)]
    assert feed.counts["garbage"] > 199_000
    (reading,) = feed.take(bytes(300) + mip_sample(reference_ns=7), 0)
    assert isinstance(reading.event, ImuSamples)


def test_values_that_are_no_numbers_are_dropped_and_counted():
    dropped: Counter[str] = Counter()
    feed = MipFeed(SensorClock("imu"), 0, Counts(), dropped)
    assert not list(feed.take(mip_sample((float("nan"), 0.0, 1.0), reference_ns=1), 0))
    assert dropped == {"imu_nan": 1}


def test_gps_time_is_utc_and_taken_while_it_is_locked():
    feed = made_feed()
    stamps = []
    for k, flags in enumerate((0b111, 0b101, 0b100, 0b000)):
        (reading,) = feed.take(mip_sample(reference_ns=k, gps=(345_600.25 + k, 2300, flags)), 0)
        assert isinstance(reading.event, ImuSamples)
        stamps.append(int(reading.event.stamps_ns[0]))
    utc_ns = (315_964_800 - 18 + 2300 * 604_800) * 10**9 + 345_600_250_000_000
    assert stamps == [utc_ns, utc_ns + 10**9, 2, 3]


@pytest.mark.parametrize(("week", "second"), [(65_535, 1.0), (0, 604_799.0), (2300, float("nan")), (2300, -1.0)])
def test_whatever_a_receiver_says_of_the_time_ends_nothing(week: int, second: float):
    feed = made_feed()
    for reference_ns in (None, 2**64 - 1, 7):
        (reading,) = feed.take(mip_sample(gps=(second, week, 0b111), reference_ns=reference_ns), 10**18)
        assert isinstance(reading.event, ImuSamples)


def test_once_gps_time_is_chosen_a_lost_lock_does_not_change_the_clock():
    feed = made_feed()
    clock = feed._clock
    list(feed.take(mip_sample(reference_ns=1, gps=(10.0, 2300, 0b101)), 0))
    assert clock.base is TimeBase.GPS
    clock.chosen = "gps"
    (reading,) = feed.take(mip_sample(reference_ns=2, gps=(11.0, 2300, 0b000)), 0)
    assert isinstance(reading.event, ImuSamples)
    assert int(reading.event.stamps_ns[0]) % 10**9 == 0
    assert not clock.locked


def test_a_device_without_a_clock_is_stamped_evenly_although_its_bytes_come_in_bursts():
    feed, chance = made_feed(), random.Random(5)
    times, waiting, stamps = 0, [], []
    for k in range(4000):  # at 250 Hz, read every few ms
        times += 4_000_000
        waiting.append(mip_sample())
        if chance.random() < 0.4:
            for reading in feed.take(b"".join(waiting), times + round(chance.expovariate(1 / 1e6))):
                assert isinstance(reading.event, ImuSamples)
                stamps += reading.event.stamps_ns.tolist()
            waiting = []
    steps_ms = np.diff(stamps)[1500:] * 1e-6
    assert (steps_ms > 0).all()
    assert np.std(steps_ms) < 0.5  # arrivals alone: 2.9
    assert np.mean(steps_ms) == pytest.approx(4.0, abs=0.05)


def test_other_data_is_counted_as_not_used():
    feed = made_feed()
    other = mip_packet({0x01: b"\x00" * 8}, descriptor_set=0x82) + mip_packet({0x06: bytes(12)})
    assert not list(feed.take(other, 0))
    assert feed.counts["unused"] == 2
