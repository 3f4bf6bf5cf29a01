"""A scan leaves the sequencer only when the IMU covers its end, and bad time never leaves it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_agent.sources import Sequencer
from splitslam.scan import GnssFix, ImuSamples, Scan, ScanPacket, WheelSamples
from tests.sources.robots import robot

MS = 1_000_000


def scan(start_ms: float, length_ms: float = 100.0, points: int = 2) -> Scan:
    start_ns, length_ns = round(start_ms * MS), round(length_ms * MS)
    offsets = np.linspace(0, length_ns, points).astype(np.int32)
    xyz = np.ones((points, 3), np.float32)
    return Scan(start_ns, start_ns + length_ns, xyz, offsets, np.zeros(points, np.uint8), np.zeros(points, np.uint8))


def imu(*stamps_ms: float) -> ImuSamples:
    stamps = np.array([round(ms * MS) for ms in stamps_ms], dtype=np.int64)
    return ImuSamples(stamps, np.zeros((len(stamps), 3)), np.zeros((len(stamps), 3)))


def wheels(ms: float) -> WheelSamples:
    return WheelSamples(np.array([round(ms * MS)], np.int64), np.zeros((1, 2)), np.zeros(1))


def fix(ms: float) -> GnssFix:
    return GnssFix(round(ms * MS), 48.0, 11.0, 0.0, None)


def told(out: list) -> list:
    """What came out, in ms: lists of IMU stamps, and scan starts."""
    return [(item.stamps_ns / MS).tolist() if isinstance(item, ImuSamples) else item.scan.stamp_ns / MS for item in out]


def with_imu() -> Sequencer:
    return Sequencer(robot())


def test_a_scan_waits_for_the_first_sample_at_or_after_its_end():
    sequencer = with_imu()
    assert told(sequencer.push(imu(90))) == [[90]]
    assert told(sequencer.push(scan(100))) == []
    assert told(sequencer.push(imu(199.9))) == [[199.9]]
    assert told(sequencer.push(imu(200))) == [[200], 100]
    assert sequencer.uncovered == 0


def test_a_chunk_of_samples_is_split_right_after_the_one_that_covers_the_scan():
    sequencer = with_imu()
    sequencer.push(scan(0))
    sequencer.push(scan(100))
    out = sequencer.push(imu(50, 101, 150, 199, 203, 210))
    assert told(out) == [[50, 101], 0, [150, 199, 203], 100, [210]]


def test_two_scans_that_one_sample_covers_go_one_after_the_other():
    sequencer = with_imu()
    sequencer.push(scan(0))
    sequencer.push(scan(100))
    assert told(sequencer.push(imu(350, 360))) == [[350], 0, 100, [360]]


def test_a_scan_that_the_imu_already_covers_passes_at_once():
    sequencer = with_imu()
    sequencer.push(imu(500))
    assert told(sequencer.push(scan(0))) == [0]


def test_without_an_imu_scans_pass_straight_through():
    sequencer = Sequencer(robot(rest="imu: null"))
    assert told(sequencer.push(scan(0))) == [0]
    assert sequencer.uncovered == 0


def test_the_last_scan_goes_at_the_end_of_input_and_is_counted_as_uncovered():
    sequencer = with_imu()
    sequencer.push(scan(0))
    sequencer.push(imu(50))
    assert told(sequencer.finish()) == [0]
    assert sequencer.uncovered == 1


def test_an_imu_that_stops_is_waited_for_once_and_not_for_ever():
    sequencer = with_imu()
    sequencer.push(imu(0))
    out = [len(sequencer.push(scan(100 * k))) for k in range(25)]
    assert out == [0] * 20 + [21, 1, 1, 1, 1]
    assert sequencer.uncovered == 25
    assert told(sequencer.push(imu(2600))) == [[2600]]  # it is back: the next scan waits again
    assert told(sequencer.push(scan(2550))) == []
    assert told(sequencer.push(imu(2700))) == [[2700], 2550]


def test_samples_for_scans_that_have_gone_without_them_are_dropped():
    sequencer = with_imu()
    for k in range(21):
        sequencer.push(scan(100 * k))
    assert told(sequencer.push(imu(1500, 2099, 2100.5))) == [[2100.5]]
    assert sequencer.dropped == {"imu_time_backwards": 2}


def test_fixes_go_with_the_next_packet_only():
    sequencer = Sequencer(robot(rest="imu: null"))
    sequencer.push(fix(10))
    sequencer.push(fix(20))
    (first,) = sequencer.push(scan(0))
    (second,) = sequencer.push(scan(100))
    assert isinstance(first, ScanPacket)
    assert isinstance(second, ScanPacket)
    assert [f.stamp_ns for f in first.fixes] == [10 * MS, 20 * MS]
    assert second.fixes == ()


def test_wheel_odometry_passes_as_it_comes_and_its_bad_time_does_not():
    sequencer = with_imu()
    sequencer.push(scan(0))
    out = [item for ms in (0, 20, 20, 10, 40, 9_000, 60) for item in sequencer.push(wheels(ms))]
    assert all(isinstance(item, WheelSamples) for item in out)
    assert [item.stamps_ns.tolist() for item in out if isinstance(item, WheelSamples)] == [
        [0],
        [20 * MS],
        [40 * MS],
        [60 * MS],
    ]
    assert sequencer.dropped == {"wheel_duplicate": 1, "wheel_time_backwards": 1, "wheel_time_jump": 1}


def test_duplicates_and_steps_back_are_dropped_by_stream():
    sequencer = Sequencer(robot())
    for ms in (0, 10, 10, 5, 20):
        sequencer.push(imu(ms))
        sequencer.push(fix(ms))
    for ms in (0, 100, 100, 50, 200):
        sequencer.push(scan(ms))
    assert sequencer.dropped == {
        "duplicate": 1,
        "time_backwards": 1,
        "imu_duplicate": 1,
        "imu_time_backwards": 1,
        "gnss_duplicate": 1,
        "gnss_time_backwards": 1,
    }


def test_steps_back_inside_a_chunk_are_dropped_too():
    sequencer = with_imu()
    out = sequencer.push(imu(0, 10, 20, 15, 20, 30))
    assert np.concatenate([item.stamps_ns for item in out if isinstance(item, ImuSamples)]).tolist() == [
        0,
        10 * MS,
        20 * MS,
        30 * MS,
    ]
    assert sequencer.dropped == {"imu_time_backwards": 1, "imu_duplicate": 1}


def test_a_chunk_that_overlaps_the_one_before_gives_its_new_samples():
    sequencer = with_imu()
    sequencer.push(imu(0, 10, 20))
    assert told(sequencer.push(imu(10, 20, 30))) == [[30]]
    assert sum(sequencer.dropped.values()) == 2


@pytest.mark.parametrize("make", [lambda ms: imu(ms), lambda ms: scan(ms, 1)], ids=["imu", "scan"])
def test_one_stamp_from_the_future_costs_one_message_not_the_rest_of_the_run(make):
    sequencer = Sequencer(robot()) if isinstance(make(0), ImuSamples) else Sequencer(robot(rest="imu: null"))
    out = [item for ms in (0, 100, 1e9, 200, 300) for item in sequencer.push(make(ms))]
    starts = [item[0] if isinstance(item, list) else item for item in told(out)]
    assert starts == [0, 100, 200, 300]
    assert [reason.removeprefix("imu_") for reason in sequencer.dropped] == ["time_jump"]


def test_a_real_gap_passes_once_the_next_message_confirms_it():
    sequencer = Sequencer(robot(rest="imu: null"))
    assert told(sequencer.push(scan(0))) == [0]
    assert told(sequencer.push(scan(60_000))) == []
    assert told(sequencer.push(scan(60_100))) == [60_000, 60_100]
    assert not sequencer.dropped


def test_a_gap_before_the_very_last_scan_loses_nothing():
    sequencer = Sequencer(robot(rest="imu: null"))
    sequencer.push(scan(0))
    sequencer.push(scan(60_000))
    assert told(sequencer.finish()) == [60_000]


def test_nan_samples_and_empty_or_nan_scans_are_dropped():
    sequencer = with_imu()
    bad = imu(0, 10)
    bad.gyro_radps[0, 1] = np.nan
    assert told(sequencer.push(bad)) == [[10]]
    sequencer.push(scan(0, points=0))
    nan = scan(100)
    nan.points_lidar[0, 0] = np.nan
    sequencer.push(nan)
    assert sequencer.dropped == {"imu_nan": 1, "empty": 1, "nan": 1}


@pytest.mark.parametrize("at_once", [False, True])
@pytest.mark.parametrize("value", [-101.0, 1e5, 1e30, -1e300])
def test_one_sample_that_no_sensor_can_mean_is_dropped_and_counted(value: float, at_once: bool):
    """One acceleration of 1e6 m/s^2 among 500 a second moves the pose by 25 m a sample."""
    for field in ("gyro_radps", "accel_mps2"):
        sequencer, bad = with_imu(), imu(0, 10, 20)
        getattr(bad, field)[1, 2] = value if field == "gyro_radps" else 10.0 * value
        out = sequencer.push_imu(bad, [0, 10 * MS, 20 * MS]) if at_once else sequencer.push(bad)
        assert [stamp for chunk in told(out) for stamp in chunk] == [0, 20]
        assert sequencer.dropped == {"imu_range": 1}


def test_what_a_hard_knock_shows_is_a_measurement():
    sequencer, hard = with_imu(), imu(0, 10)
    hard.accel_mps2[1], hard.gyro_radps[1] = (-400.0, 0.0, 400.0), 70.0
    assert told(sequencer.push(hard)) == [[0, 10]]
    assert not sequencer.dropped


@given(st.lists(st.tuples(st.sampled_from(["imu", "scan"]), st.integers(0, 900) | st.integers(0, 10_000)), max_size=60))
def test_whatever_comes_time_goes_forward_and_nothing_is_lost_silently(steps):
    sequencer = with_imu()
    out: list = []
    for kind, ms in steps:
        out += sequencer.push(imu(ms) if kind == "imu" else scan(ms, 50))
    out += sequencer.finish()
    imu_stamps = [ns for item in out if isinstance(item, ImuSamples) for ns in item.stamps_ns.tolist()]
    packets = [item for item in out if isinstance(item, ScanPacket)]
    starts = [packet.scan.stamp_ns for packet in packets]
    assert imu_stamps == sorted(set(imu_stamps))
    assert starts == sorted(set(starts))
    assert len(imu_stamps) + len(packets) + sum(sequencer.dropped.values()) == len(steps)
    uncovered, latest = 0, -1
    for item in out:
        if isinstance(item, ImuSamples):
            latest = int(item.stamps_ns[-1])
        else:
            uncovered += latest < item.scan.end_ns
    assert uncovered == sequencer.uncovered


def one_by_one(out: list) -> list:
    """`told` with every sample for itself."""
    return [entry for group in told(out) for entry in (group if isinstance(group, list) else [("scan", group)])]


STEPS_MS = st.integers(1, 20) | st.sampled_from([-700, -50, 0, 900, 1_500, 20_000])


@given(st.lists(st.tuples(st.lists(st.tuples(STEPS_MS, st.booleans()), min_size=1, max_size=12), st.integers(5, 60))))
def test_messages_taken_together_are_what_they_are_one_after_the_other(runs):
    apart, together = with_imu(), with_imu()
    out: tuple[list, list] = [], []
    stamp_ms = arrival_ms = 1_000
    for steps, waited_ms in runs:
        samples = imu(*(stamp_ms := stamp_ms + step for step, _ in steps))
        samples.accel_mps2[[bad and stamp_ms % 7 == 0 for _, bad in steps]] = np.inf
        arrivals_ns = [MS * (arrival_ms + k * waited_ms) for k in range(len(steps))]
        arrival_ms += len(steps) * waited_ms
        for k, arrival_ns in enumerate(arrivals_ns):
            alone = ImuSamples(samples.stamps_ns[[k]], samples.gyro_radps[[k]], samples.accel_mps2[[k]])
            out[0].extend(apart.push(alone, arrival_ns))
        out[1].extend(together.push_imu(samples, arrivals_ns))
        for sequencer, items in zip((apart, together), out, strict=True):
            items.extend(sequencer.push(scan(stamp_ms, 30), MS * arrival_ms))
    assert one_by_one(out[1]) == one_by_one(out[0])
    assert together.dropped == apart.dropped
    assert together.times.steps == apart.times.steps


def test_a_step_of_the_clock_is_put_right_by_the_same_amount_when_messages_are_taken_together():
    late_ms = np.random.default_rng(3).integers(1, 30, 200)
    stamps_ms = np.arange(200) * 20
    arrivals_ns = [int(ns) for ns in MS * (stamps_ms + late_ms)]
    stamps_ms[100:] -= 5_000
    apart, together = with_imu(), with_imu()
    out: tuple[list, list] = [], []
    for part in np.array_split(np.arange(200), 20):
        out[1].extend(together.push_imu(imu(*stamps_ms[part].tolist()), [arrivals_ns[k] for k in part]))
        for k in part:
            out[0].extend(apart.push(imu(float(stamps_ms[k])), arrivals_ns[k]))
    assert one_by_one(out[1]) == one_by_one(out[0])
    assert together.times.steps == apart.times.steps == {"imu": 1}
