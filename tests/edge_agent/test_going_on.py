"""An agent that goes on with a run: which part of a recording is its own, and what it says of the time before."""

from __future__ import annotations

import numpy as np

from edge_agent.going_on import StartAfter, UnseenMotion
from splitslam import se3
from splitslam.features import Knots, Motion
from splitslam.scan import GnssFix, ImuSamples, Scan, WheelSamples
from tests.edge_agent.test_loop import SCAN_NS, imu_at, scan

RATE_RADPS = 0.4


class Node:
    """Turns to the left at an even rate, and knows nothing of its past."""

    def motion_over(self, start_ns: int, end_ns: int) -> Motion:
        offsets_ns = np.array([0, end_ns - start_ns])
        turn = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, RATE_RADPS * offsets_ns[1] * 1e-9]])
        knots = Knots(offsets_ns, turn, np.zeros((2, 3)))
        return Motion(np.eye(4), np.eye(6) * 1e-8, np.zeros(3), knots, np.array([0, 0, -1.0]), 0.01, True)


def test_what_an_agent_before_has_done_is_left_out_and_the_samples_that_level_the_robot_are_not():
    after = StartAfter(seq=3, stamp_ns=30 * SCAN_NS)
    events = [(k, event) for k in range(60) for event in (imu_at(k * SCAN_NS), scan(k), fix(k))]
    own = [timed[1] for timed in after.events(iter(events)) if timed is not None]
    assert [event.stamp_ns // SCAN_NS for event in own if isinstance(event, Scan)] == list(range(31, 60))
    assert after.skipped == 31
    assert not after.dropped, "the agent before has had them"
    assert min(int(e.stamps_ns[0]) // SCAN_NS for e in own if isinstance(e, ImuSamples)) == 26
    assert min(e.stamp_ns // SCAN_NS for e in own if isinstance(e, GnssFix)) == 26


def test_a_live_sensors_clock_that_was_set_back_between_two_agents_costs_no_scan():
    after = StartAfter(seq=3, stamp_ns=30 * SCAN_NS, live=True)
    events = [(k, event) for k in range(10) for event in (imu_at(k * SCAN_NS), scan(k))]
    own = [timed[1] for timed in after.events(iter([None, *events])) if timed is not None]
    stamps_ns = [event.stamp_ns for event in own if isinstance(event, Scan)]
    assert stamps_ns == [30 * SCAN_NS + 10**9 + k * SCAN_NS for k in range(10)]
    samples_ns = [int(event.stamps_ns[0]) for event in own if isinstance(event, ImuSamples)]
    assert samples_ns == stamps_ns[1:]  # those before the first scan are of no use
    assert after.skipped == 0
    assert after.dropped == {"imu_time_backwards": 1}


def test_a_live_sensors_samples_that_have_no_place_in_the_run_are_counted_one_by_one():
    after = StartAfter(seq=3, stamp_ns=30 * SCAN_NS, live=True)
    stamps_ns = np.arange(3) * SCAN_NS
    samples = ImuSamples(stamps_ns, np.zeros((3, 3)), np.zeros((3, 3)))
    early = [samples, fix(3), WheelSamples(stamps_ns[:2] + 4 * SCAN_NS, np.zeros((2, 2)), np.zeros(2))]
    events = [(k, event) for k, event in enumerate([*early, scan(6), imu_at(7 * SCAN_NS), fix(8)])]
    own = [timed[1] for timed in after.events(iter(events)) if timed is not None]
    assert [type(event) for event in own] == [Scan, ImuSamples, GnssFix]
    assert after.dropped == {"imu_time_backwards": 3, "gnss_time_backwards": 1, "wheel_time_backwards": 2}


def fix(k: int) -> GnssFix:
    return GnssFix(k * SCAN_NS, 48.0, 11.0, 0.0, None)


def test_the_first_motion_after_a_restart_says_that_nobody_has_seen_it():
    motion = UnseenMotion(Node(), after_ns=0)
    first = motion.motion_over(SCAN_NS, 2 * SCAN_NS)
    assert not first.velocity_known
    np.testing.assert_allclose(se3.log(first.T_prev_lidar), [0, 0, 0.1 * RATE_RADPS, 0, 0, 0], atol=1e-12)
    sigmas = np.sqrt(np.diag(first.covariance))
    assert sigmas[:3].min() >= 0.1  # a robot turns by 1 rad/s ...
    assert sigmas[3:].min() >= 0.5  # ... and drives at 5 m/s
    assert motion.motion_over(2 * SCAN_NS, 3 * SCAN_NS).velocity_known


def test_after_a_long_time_the_turn_is_anyone_s_guess():
    first = UnseenMotion(Node(), after_ns=0).motion_over(200 * SCAN_NS, 201 * SCAN_NS)
    assert se3.angle(first.T_prev_lidar) < 0.2
    sigmas = np.sqrt(np.diag(first.covariance))
    assert 2.0 < sigmas[0] < np.pi
    assert sigmas[3] >= 100.0
