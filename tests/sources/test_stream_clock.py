"""Clocks that step, drivers that start anew, sensors that are unplugged: the run's time goes on, and says what it met.

Made streams of a robot with all four sensors, cut into messages that arrive a few milliseconds after their stamps.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge_agent.sources import Sequencer
from splitslam.scan import GnssFix, ImuSamples, Scan, ScanPacket, WheelSamples
from tests.sources.robots import robot
from tests.sources.test_sequencer import MS, fix, imu, scan, wheels

HOUR_MS = 3_600_000.0
LATENCY_MS = {"lidar": 30.0, "imu": 4.0, "wheels": 6.0, "gnss": 80.0}
START_MS = 1e9


@dataclass(frozen=True)
class Event:
    """One message: its true time, what its stamp says, when it came."""

    stream: str
    true_ms: float
    stamp_ms: float
    arrival_ms: float

    def message(self) -> Scan | ImuSamples | WheelSamples | GnssFix:
        if self.stream == "imu":
            return imu(*(self.stamp_ms + 4.0 * np.arange(5)))  # five samples a message
        make = {"lidar": scan, "wheels": wheels, "gnss": fix}[self.stream]
        return make(self.stamp_ms)


def drive(seconds: float, seed: int = 0, latency_ms: dict[str, float] = LATENCY_MS) -> list[Event]:
    """Everything that the sensors say, in the order in which it comes."""
    rng = np.random.default_rng(seed)
    periods_ms = {"lidar": 100.0, "imu": 20.0, "wheels": 50.0, "gnss": 1000.0}
    events = []
    for stream, period_ms in periods_ms.items():
        true_ms = START_MS + period_ms * np.arange(int(seconds * 1000 / period_ms))
        length_ms = {"lidar": 100.0, "imu": 16.0}.get(stream, 0.0)
        late_ms = latency_ms[stream] * (1 + 0.3 * rng.exponential(size=len(true_ms)))
        arrival_ms = np.maximum.accumulate(true_ms + length_ms + late_ms)
        events += [Event(stream, *times) for times in zip(true_ms, true_ms, arrival_ms, strict=True)]
    return sorted(events, key=lambda event: event.arrival_ms)


def stepped(events: list[Event], at_s: float, by_ms: float, streams: set[str]) -> list[Event]:
    """The clock of these streams steps."""

    def one(event: Event) -> Event:
        if event.stream not in streams or event.true_ms < START_MS + at_s * 1000:
            return event
        return Event(event.stream, event.true_ms, event.stamp_ms + by_ms, event.arrival_ms)

    return [one(event) for event in events]


def silent(events: list[Event], from_s: float, to_s: float, streams: set[str]) -> list[Event]:
    span = (START_MS + from_s * 1000, START_MS + to_s * 1000)
    return [e for e in events if e.stream not in streams or not span[0] <= e.true_ms < span[1]]


@dataclass
class Run:
    """What came out: stamps by stream, ms after the start."""

    stamps_ms: dict[str, np.ndarray]
    sequencer: Sequencer

    @property
    def dropped(self) -> Counter[str]:
        return self.sequencer.dropped


def run(events: list[Event], arrivals: bool = True) -> Run:
    sequencer = Sequencer(robot())
    out: dict[str, list[float]] = {"lidar": [], "imu": [], "wheels": [], "gnss": []}

    def take(items) -> None:
        for item in items:
            if isinstance(item, ScanPacket):
                assert item.scan.end_ns - item.scan.stamp_ns == 100 * MS
                out["lidar"].append(item.scan.stamp_ns / MS)
                out["gnss"] += [f.stamp_ns / MS for f in item.fixes]
            else:
                out["imu" if isinstance(item, ImuSamples) else "wheels"] += (item.stamps_ns / MS).tolist()

    for event in events:
        take(sequencer.push(event.message(), round(event.arrival_ms * MS) if arrivals else None))
    take(sequencer.finish())
    return Run({name: np.array(values) - START_MS for name, values in out.items()}, sequencer)


def errors_ms(result: Run, stream: str, period_ms: float) -> np.ndarray:
    """By how much each stamp is off, for streams of which nothing is missing."""
    return result.stamps_ms[stream] - period_ms * np.arange(len(result.stamps_ms[stream]))


ALL = {"lidar", "imu", "wheels", "gnss"}


def test_a_drive_without_trouble_passes_as_it_is():
    result = run(drive(12.0))
    assert len(result.stamps_ms["lidar"]) == 120
    assert np.abs(errors_ms(result, "lidar", 100.0)).max() == 0
    assert not result.dropped
    assert not result.sequencer.times.steps


@pytest.mark.parametrize("by_ms", [HOUR_MS, -HOUR_MS, 2_500.0, -2_500.0, -600.0])
def test_when_the_wall_clock_steps_the_run_goes_on_with_all_streams_in_step(by_ms: float):
    result = run(stepped(drive(12.0), 6.0, by_ms, ALL))
    assert not result.dropped
    slow = by_ms == -600.0  # a fix a second: a step of less does not show in the order of its stamps
    assert result.sequencer.times.steps == dict.fromkeys(ALL - {"gnss"} if slow else ALL, 1)
    assert [len(result.stamps_ms[s]) for s in ("lidar", "imu", "wheels")] == [120, 3000, 240]
    after = {s: errors_ms(result, s, p)[-1] for s, p in (("lidar", 100.0), ("imu", 4.0), ("wheels", 50.0))}
    assert after["lidar"] == after["imu"] == after["wheels"]  # to the nanosecond: they must stay in step
    assert abs(after["lidar"]) < 30.0  # what arrivals cannot tell
    for stream in ALL:
        assert (np.diff(result.stamps_ms[stream]) > 0).all()


@settings(max_examples=10, deadline=None)
@given(
    st.integers(0, 1000),
    st.floats(4.0, 8.0),
    st.floats(-1e7, 1e7).filter(lambda by: abs(by) > 4000),
    st.sets(st.sampled_from(sorted(ALL)), min_size=1),
)
def test_whatever_clock_steps_by_how_much_nothing_is_lost_and_time_goes_forward(
    seed: int, at_s: float, by_ms: float, streams: set[str]
):
    result = run(stepped(drive(12.0, seed), at_s, by_ms, streams))
    assert not result.dropped
    assert result.sequencer.times.steps == dict.fromkeys(streams, 1)
    assert len(result.stamps_ms["lidar"]) == 120
    assert len(result.stamps_ms["imu"]) == 3000
    assert (np.diff(result.stamps_ms["imu"]) > 0).all()
    assert np.abs(errors_ms(result, "lidar", 100.0)).max() < 60.0


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 1000), st.floats(-1e7, 1e7), st.floats(0.1, 2.0))
def test_without_a_step_none_is_seen_however_late_messages_come(seed: int, by_ms: float, late_s: float):
    events = drive(12.0, seed)
    rng = np.random.default_rng(seed)
    # a network that holds everything back now and then, and single stamps that are wrong
    stalls_ms = START_MS + rng.uniform(0, 12_000, 5)
    for k, event in enumerate(events):
        arrival_ms = event.arrival_ms
        for stall_ms in stalls_ms:
            if stall_ms <= arrival_ms < stall_ms + late_s * 1000:
                arrival_ms = stall_ms + late_s * 1000
        settled = event.stream != "imu" and 4000 < event.true_ms - START_MS < 11_000
        wrong = settled and rng.random() < 0.01 and abs(by_ms) > 2000
        events[k] = Event(event.stream, event.true_ms, event.stamp_ms + wrong * by_ms, arrival_ms)
    result = run(sorted(events, key=lambda e: e.arrival_ms))
    assert not result.sequencer.times.steps
    assert sum(result.dropped.values()) <= sum(e.stamp_ms != e.true_ms for e in events)
    assert np.isin(np.round(result.stamps_ms["lidar"]), 100.0 * np.arange(120)).all()


@pytest.mark.parametrize("restart_ms", [-START_MS + 5.0, -1.5e9, 7e8], ids=["counts from zero", "behind", "ahead"])
def test_a_lidar_that_comes_back_after_twenty_seconds_with_another_idea_of_the_time_goes_on(restart_ms: float):
    events = stepped(silent(drive(30.0), 4.0, 24.0, {"lidar"}), 24.0, restart_ms, {"lidar"})
    result = run(events)
    assert not result.dropped
    assert result.sequencer.times.steps == {"lidar": 1}
    stamps_ms = result.stamps_ms["lidar"]
    assert len(stamps_ms) == 100
    assert stamps_ms[40] == pytest.approx(24_000, abs=30.0)
    assert np.diff(stamps_ms[40:]) == pytest.approx(100.0)


@pytest.mark.parametrize("streams", [{"lidar"}, {"imu"}, {"lidar", "imu"}, ALL])
def test_sensors_that_are_unplugged_for_twenty_seconds_cost_that_time_and_no_more(streams: set[str]):
    result = run(silent(drive(30.0), 4.0, 24.0, streams))
    assert not result.sequencer.times.steps
    assert not result.dropped
    lost = 200 if "lidar" in streams else 0
    assert len(result.stamps_ms["lidar"]) == 300 - lost
    assert result.stamps_ms["lidar"][-1] == 29_900
    assert result.stamps_ms["imu"][-1] >= 29_980


def test_where_nobody_knows_when_messages_came_a_step_back_is_dropped_and_one_ahead_is_a_gap():
    ahead = run(stepped(drive(12.0), 6.0, HOUR_MS, ALL), arrivals=False)
    assert not ahead.dropped
    assert ahead.stamps_ms["lidar"][-1] == pytest.approx(HOUR_MS + 11_900)
    behind = run(stepped(drive(12.0), 6.0, -HOUR_MS, ALL), arrivals=False)
    assert behind.dropped["time_backwards"] == 60
    assert not behind.sequencer.times.steps


@pytest.mark.parametrize("pace", [0.1, 0.6])
def test_in_a_recording_that_was_written_in_one_go_a_pause_is_no_step(pace: float):
    """Its times of arrival are those of a disk, faster than the drive's."""
    events = silent(drive(30.0), 4.0, 24.0, {"lidar"})
    hurried = [Event(e.stream, e.true_ms, e.stamp_ms, START_MS + (e.arrival_ms - START_MS) * pace) for e in events]
    result = run(hurried)
    assert not result.sequencer.times.steps
    assert result.stamps_ms["lidar"][-1] == 29_900


def test_two_steps_in_one_run_are_both_put_right():
    result = run(stepped(stepped(drive(20.0), 6.0, HOUR_MS, ALL), 13.0, -2 * HOUR_MS, ALL))
    assert not result.dropped
    assert result.sequencer.times.steps == dict.fromkeys(ALL, 2)
    assert np.abs(errors_ms(result, "lidar", 100.0)).max() < 60.0


def test_messages_stay_in_order_across_streams() -> None:
    """A scan still leaves only when the IMU covers its end."""
    sequencer = Sequencer(robot())
    covered_ms = 0.0
    for event in stepped(drive(12.0), 6.0, -HOUR_MS, ALL):
        for item in sequencer.push(event.message(), round(event.arrival_ms * MS)):
            if isinstance(item, ImuSamples):
                covered_ms = item.stamps_ns[-1] / MS
            if isinstance(item, ScanPacket):
                assert covered_ms >= item.scan.end_ns / MS
    assert sequencer.uncovered == 0


def test_a_stream_that_begins_with_a_wrong_stamp_is_not_taken_for_one_whose_clock_stepped():
    events = drive(12.0)
    first = next(k for k, event in enumerate(events) if event.stream == "wheels")
    wrong = events[first]
    events[first] = Event("wheels", wrong.true_ms, wrong.stamp_ms + 2000.0, wrong.arrival_ms)
    result = run(events)
    assert not result.sequencer.times.steps
    assert result.dropped == {"wheel_time_backwards": 39, "wheel_duplicate": 1}


def test_a_second_of_old_messages_sent_again_is_dropped_and_no_step():
    events = drive(12.0)
    old = [e for e in events if 3000 <= e.true_ms - START_MS < 4000]
    again = [Event(e.stream, e.true_ms, e.stamp_ms, START_MS + 6000 + 0.1 * k) for k, e in enumerate(old)]
    result = run(sorted([*events, *again], key=lambda e: e.arrival_ms))
    assert not result.sequencer.times.steps
    assert result.dropped["time_backwards"] == 10
    assert len(result.stamps_ms["lidar"]) == 120


def test_a_pause_ends_even_when_nobody_can_say_what_it_was():
    """Arrivals that stand still after it contradict both a gap and a step: after two seconds it was a gap."""
    events = silent(drive(30.0), 4.0, 14.0, {"lidar"})
    still = [Event(e.stream, e.true_ms, e.stamp_ms, min(e.arrival_ms, START_MS + 4500)) for e in events]
    result = run([e for e in still if e.true_ms < START_MS + 17_000])
    assert not result.sequencer.times.steps
    assert result.stamps_ms["lidar"][-1] == 16_900
