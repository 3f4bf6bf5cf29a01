"""Locks that come and go while the run goes on: its time does not step, and no sensor's stamps do."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import pytest

from edge_agent.sources.live.clock import RunClock
from edge_agent.sources.live.sensor_clock import TimeBase
from tests import tolerances as bars

SECOND_NS = 1_000_000_000
T0_NS = 1_700_000_000 * SECOND_NS


@dataclass
class MadeSensor:
    """ahead_s: its clock's lead over true time from each time on, s, and whose it is then. way_ms: of its messages."""

    name: str
    rate_hz: float
    way_ms: float
    phases: Sequence[tuple[float, float, TimeBase]]
    jitter_ms: float = 0.2
    stamps: list[tuple[float, float]] = field(default_factory=list)  # true time, and stamp in the run less it, s

    def at(self, true_s: float) -> tuple[float, TimeBase]:
        return next((ahead_s, base) for since_s, ahead_s, base in reversed(self.phases) if true_s >= since_s)

    def errors_s(self, since_s: float, until_s: float) -> list[float]:
        return [error_s for true_s, error_s in self.stamps if since_s <= true_s < until_s]

    def steps_s(self) -> list[float]:
        """From stamp to stamp in the run, less what has passed."""
        return [after - before for (_, before), (_, after) in pairwise(self.stamps)]


def drive(sensors: Sequence[MadeSensor], seconds: float, choice: str = "auto") -> RunClock:
    """All sensors send by the clock; what they send gets its stamp in the run."""
    waits_for = [sensor.name for sensor in sensors if sensor.name != "gnss"]
    clocks, chance = RunClock(choice, 0.05, waits_for), random.Random(5)  # pyright: ignore[reportArgumentType]
    sent = sorted(
        (k / sensor.rate_hz, n) for n, sensor in enumerate(sensors) for k in range(int(seconds * sensor.rate_hz))
    )
    for true_s, n in sent:
        sensor = sensors[n]
        clock, (ahead_s, base) = clocks.clock(sensor.name), sensor.at(true_s)
        true_ns = T0_NS + round(true_s * 1e9)
        sensor_ns = true_ns + round(ahead_s * 1e9)
        arrival_ns = true_ns + round((sensor.way_ms + chance.expovariate(1 / sensor.jitter_ms)) * 1e6)
        clock.heard(sensor_ns, arrival_ns, base)
        if clocks.ready(clock, arrival_ns):
            sensor.stamps.append((true_s, (sensor_ns + clocks.offset_ns(clock) - true_ns) * 1e-9))
        clocks.look_around()
    return clocks


def lidar(*phases: tuple[float, float, TimeBase]) -> MadeSensor:
    return MadeSensor("lidar", 754.0, 1.0, phases)


def imu(*phases: tuple[float, float, TimeBase]) -> MadeSensor:
    return MadeSensor("imu", 500.0, 3.0, phases)


OWN, GPS, PTP = TimeBase.OWN, TimeBase.GPS, TimeBase.PTP
OWN_AHEAD_S, LOCKED_S = -1234.567891, 10.0


@pytest.mark.parametrize("ahead_s", [0.3, -0.3, 18.0, 1.7e3])
def test_a_lock_that_comes_steps_no_stamp_whatever_the_sensors_clock_does(ahead_s: float):
    sensor = lidar((0.0, OWN_AHEAD_S, OWN), (LOCKED_S, OWN_AHEAD_S + ahead_s, GPS))
    clocks = drive([sensor], 20.0)
    assert clocks.clock("lidar").chosen == "gps"
    assert clocks.clock("lidar").changes == 1
    assert max(map(abs, sensor.steps_s())) < bars.LOCK_STEP_S
    assert max(map(abs, sensor.errors_s(2.0, 20.0))) < bars.LIVE_CLOCK_S


def test_sensors_that_share_a_lock_that_comes_later_are_tied_to_each_other_by_it_to_the_nanosecond():
    """By when their messages come the IMU was 2 ms late against the LiDAR: that is moved out, and not at once."""
    first = lidar((0.0, OWN_AHEAD_S, OWN), (LOCKED_S, 0.25, GPS))
    second = imu((0.0, -77.0, OWN), (LOCKED_S + 3.0, 0.25, GPS))
    clocks = drive([first, second], 25.0)
    assert [clock.chosen for clock in clocks.all()] == ["gps", "gps"]
    before = second.errors_s(9.0, 10.0)[0] - first.errors_s(9.0, 10.0)[0]
    assert before == pytest.approx(2e-3, abs=0.3e-3)
    assert clocks.offset_ns(clocks.clock("lidar")) == clocks.offset_ns(clocks.clock("imu"))
    for sensor in (first, second):
        assert max(map(abs, sensor.steps_s())) < bars.LOCK_STEP_S
        assert sensor.stamps == sorted(sensor.stamps)


def test_a_lock_that_goes_leaves_the_run_on_our_own_clock_and_one_that_comes_back_is_taken_as_it_was():
    """Meanwhile its own clock has run away by 5 ms, which the pulse puts right at once, and we slowly."""
    sensor = lidar((0.0, 0.25, GPS), (10.0, 0.25, OWN), (16.0, 0.255, GPS))
    clocks = drive([sensor], 26.0)
    assert clocks.clock("lidar").chosen == "gps"
    assert clocks.clock("lidar").changes == 2
    assert clocks.offset_ns(clocks.clock("lidar")) == 0, "the run's time is GPS' again, to the nanosecond"
    assert max(map(abs, sensor.steps_s())) < bars.LOCK_STEP_S
    still = sensor.errors_s(10.0, 16.0)
    assert max(still) - min(still) < bars.LIVE_CLOCK_S


def test_when_the_lidar_loses_its_lock_the_imu_that_keeps_it_holds_the_run_in_that_time():
    first = lidar((0.0, 0.25, GPS), (10.0, 0.25, OWN))
    second = imu((0.0, 0.25, GPS))
    clocks = drive([first, second], 20.0)
    assert [clock.chosen for clock in clocks.all()] == ["host", "gps"]
    assert clocks.offset_ns(clocks.clock("imu")) == 0
    assert max(map(abs, (error_s - 0.25 for error_s in first.errors_s(2.0, 20.0)))) < 2 * bars.LIVE_CLOCK_S


def test_a_lock_that_is_seconds_off_from_another_sensors_is_not_believed_until_it_is_right():
    first = lidar((0.0, 0.0, GPS))
    second = imu((0.0, -77.0, OWN), (8.0, 18.0, GPS), (16.0, -77.0, OWN), (20.0, 0.0, GPS))
    clocks = drive([first, second], 16.0)
    assert clocks.clock("imu").chosen == "host"
    assert clocks.problems == ["imu: its gps time is -17.998 s behind lidar's; it is stamped when its messages come"]
    assert max(map(abs, second.steps_s())) < bars.LOCK_STEP_S
    clocks = drive([lidar((0.0, 0.0, GPS)), imu(*second.phases)], 26.0)
    assert clocks.clock("imu").chosen == "gps"
    assert not clocks.problems


def test_without_a_wish_for_sensors_time_a_lock_changes_nothing():
    sensor = lidar((0.0, OWN_AHEAD_S, OWN), (LOCKED_S, 0.25, GPS))
    clocks = drive([sensor], 20.0, choice="host")
    assert clocks.clock("lidar").chosen == "host"
    assert max(map(abs, sensor.steps_s())) < bars.LOCK_STEP_S


def test_one_that_is_waited_for_is_a_problem_until_it_comes():
    sensor = lidar((0.0, OWN_AHEAD_S, OWN), (LOCKED_S, 0.25, PTP))
    assert drive([sensor], 9.0, choice="ptp").problems
    assert not drive([sensor], 20.0, choice="ptp").problems


def test_fixes_are_placed_anew_by_the_lock_and_their_messages_wait_for_it():
    first = lidar((0.0, OWN_AHEAD_S, OWN), (LOCKED_S, -0.3, GPS))
    fixes = MadeSensor("gnss", 5.0, 150.0, [(0.0, -0.3, GPS)], jitter_ms=5.0)
    clocks = drive([first, fixes], 20.0)
    assert clocks.clock("gnss").chosen == "gps"
    assert fixes.errors_s(15.0, 20.0)[-1] == pytest.approx(first.errors_s(15.0, 20.0)[-1], abs=1e-6)
