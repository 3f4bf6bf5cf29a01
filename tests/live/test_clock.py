"""Every sensor's stamps come into one time, which nobody's clock moves."""

from __future__ import annotations

import random
from collections.abc import Sequence
from itertools import pairwise

import pytest

from edge_agent.sources.live.clock import RunClock
from edge_agent.sources.live.lateness import Lateness
from edge_agent.sources.live.sensor_clock import SensorClock, TimeBase
from tests import tolerances as bars

SECOND_NS = 1_000_000_000
T0_NS = 1_700_000_000 * SECOND_NS


def hear(clock: SensorClock, base: TimeBase, ahead_s: float, way_ms: float = 1.0, seconds: float = 3.0) -> None:
    """Messages at 100 Hz of a sensor whose clock is ahead of ours, and whose messages take their time."""
    for k in range(int(seconds * 100)):
        true_ns = T0_NS + k * 10_000_000
        clock.heard(true_ns + round(ahead_s * 1e9), true_ns + round(way_ms * 1e6), base)


def ready(clocks: RunClock, seconds: float = 3.0) -> None:
    for clock in clocks.all():
        clocks.ready(clock, T0_NS)
    for clock in clocks.all():
        assert clocks.ready(clock, T0_NS + round(seconds * 1e9))


def run_clock(
    choice: str, *sensors: tuple[str, TimeBase, float], waits_for: Sequence[str] = ("lidar", "imu")
) -> RunClock:
    clocks = RunClock(choice, 0.05, [name for name, *_ in sensors if name in waits_for])  # pyright: ignore[reportArgumentType]
    for name, base, ahead_s in sensors:
        hear(clocks.clock(name), base, ahead_s)
    ready(clocks)
    return clocks


def error_s(clocks: RunClock, name: str, ahead_s: float, reference_ahead_s: float = 0.0) -> float:
    """By how much a stamp of the sensor is late in the run's time, which is `reference_ahead_s` ahead of ours."""
    return clocks.offset_ns(clocks.clock(name)) * 1e-9 + ahead_s - reference_ahead_s


def test_a_sensor_with_a_clock_of_its_own_is_stamped_when_its_quickest_messages_come():
    clocks = run_clock("auto", ("lidar", TimeBase.OWN, -1.6e9))
    assert error_s(clocks, "lidar", -1.6e9) == pytest.approx(0.001, abs=1e-6)
    assert clocks.clock("lidar").chosen == "host"
    assert not clocks.problems


def test_sensors_that_are_locked_to_gps_keep_their_stamps_and_others_are_tied_to_them():
    clocks = run_clock("auto", ("lidar", TimeBase.GPS, 3600.2), ("imu", TimeBase.OWN, 17.0))
    assert clocks.offset_ns(clocks.clock("lidar")) == 0
    assert error_s(clocks, "imu", 17.0, 3600.2) == pytest.approx(0.0, abs=1e-6)
    assert [clock.chosen for clock in clocks.all()] == ["gps", "host"]


def test_two_sensors_locked_to_the_same_time_keep_their_stamps_to_the_nanosecond():
    clocks = run_clock("auto", ("lidar", TimeBase.PTP, 37.0), ("imu", TimeBase.PTP, 37.0))
    assert [clocks.offset_ns(clock) for clock in clocks.all()] == [0, 0]


def test_a_sensor_that_says_it_is_locked_but_is_18_s_off_is_not_believed_and_said_to_be():
    clocks = run_clock("auto", ("lidar", TimeBase.GPS, 0.0), ("imu", TimeBase.GPS, 18.0))
    assert error_s(clocks, "imu", 18.0) == pytest.approx(0.0, abs=1e-6)
    assert clocks.problems == ["imu: its gps time is -18.000 s behind lidar's; it is stamped when its messages come"]


def test_host_takes_nobodys_time_and_gps_says_who_is_not_locked():
    host = run_clock("host", ("lidar", TimeBase.GPS, 5.0), ("imu", TimeBase.GPS, 5.0))
    assert [clock.chosen for clock in host.all()] == ["host", "host"]
    assert not host.problems
    gps = run_clock("gps", ("lidar", TimeBase.OWN, 5.0), ("imu", TimeBase.GPS, 0.0))
    assert [clock.chosen for clock in gps.all()] == ["host", "gps"]
    assert gps.problems == ["lidar: not locked to gps, as clock: gps asks; it is stamped when its messages come"]


@pytest.mark.parametrize(("ahead_s", "chosen"), [(0.0, "gps"), (-0.3, "gps"), (-7200.0, "host"), (0.5, "host")])
def test_fixes_keep_utc_where_the_run_is_in_it_and_follow_when_our_clock_is_wrong(ahead_s: float, chosen: str):
    clocks = run_clock("auto", ("lidar", TimeBase.OWN, 3.0), ("gnss", TimeBase.GPS, ahead_s), waits_for=["lidar"])
    assert clocks.clock("gnss").chosen == chosen


def test_nobody_is_placed_before_the_reference_is_known_and_a_sensor_that_never_comes_is_not_waited_for_for_ever():
    clocks = RunClock("auto", 0.05, ["lidar", "imu"])
    hear(clocks.clock("imu"), TimeBase.OWN, 0.0)
    assert not clocks.ready(clocks.clock("imu"), T0_NS)
    assert not clocks.ready(clocks.clock("imu"), T0_NS + 2 * SECOND_NS - 1)
    assert clocks.ready(clocks.clock("imu"), T0_NS + 2 * SECOND_NS)


def test_before_the_choice_another_time_base_begins_anew():
    clock = RunClock("auto", 0.05, ["lidar"]).clock("lidar")
    hear(clock, TimeBase.OWN, 0.0)
    assert clock.lateness.settled
    clock.heard(T0_NS, T0_NS, TimeBase.GPS)
    assert not clock.lateness.settled
    assert clock.age == 1


@pytest.mark.parametrize("drift", [-80e-6, 0.0, 80e-6])
def test_a_clock_that_drifts_is_followed_through_late_messages_and_no_stamp_goes_back(drift: float):
    lateness, chance = Lateness(), random.Random(7)
    errors_s, stamps_ns = [], []
    for k in range(12_000):  # two minutes at 100 Hz
        true_ns = k * 10_000_000
        sensor_ns = round(true_ns * (1.0 + drift)) + 5 * SECOND_NS
        arrival_ns = true_ns + 1_000_000 + round(chance.expovariate(1 / 3e6))
        lateness.observe(sensor_ns, arrival_ns)
        if lateness.settled:
            stamps_ns.append(sensor_ns + lateness.offset_ns)
            errors_s.append((stamps_ns[-1] - true_ns) * 1e-9 - 0.001)
    assert all(b > a for a, b in pairwise(stamps_ns))
    assert max(map(abs, errors_s[2000:])) < bars.LIVE_CLOCK_S
    assert lateness.offset_ns != lateness.latest_ns or drift == 0.0


def test_a_step_of_a_sensors_clock_is_left_to_the_streams_own_clock_and_drift_is_followed_on():
    lateness = Lateness()
    offsets = []
    for k in range(6000):
        true_ns = k * 10_000_000
        stepped_ns = 0 if k < 2000 else 40 * SECOND_NS
        drift_ns = round(true_ns * 50e-6)
        lateness.observe(true_ns + stepped_ns + drift_ns, true_ns + 1_000_000)
        offsets.append(lateness.offset_ns if lateness.settled else None)
    assert abs(offsets[2500] - offsets[1999]) < 5_000_000  # not 40 s
    assert offsets[-1] - offsets[3000] == pytest.approx(-30 * 50e-6 * 1e9, rel=0.2)


def test_a_hiccup_of_our_own_does_not_move_the_offset():
    lateness = Lateness()
    for k in range(1000):
        late_ns = 400_000_000 if 500 <= k < 540 else 0
        lateness.observe(k * 10_000_000, k * 10_000_000 + 1_000_000 + late_ns)
    assert lateness.offset_ns == pytest.approx(1_000_000, abs=1000)
