"""Without answers the edge goes on by its own odometry, and `odom` does not notice when the service is back."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from edge_agent.odometry.outage import LOST, UNANCHORED, Correction, Outages
from edge_agent.odometry.scan_matching import Outcome
from edge_agent.odometry.settings import OdometrySettings
from edge_agent.types import OdometryReply
from splitslam import se3
from tests import tolerances as bars
from tests.odometry.made import SCAN_NS, answer, frame, pose, without_points

KNOWN, SILENT = 20, 15  # scans


def steady(reply: OdometryReply | None) -> np.ndarray:
    """What the Imu node takes in."""
    assert reply is not None
    return se3.inv(reply.T_map_odom) @ reply.T_map_lidar


def off_m(reply: OdometryReply | None) -> float:
    assert reply is not None
    return float(np.linalg.norm((se3.inv(pose(reply.seq)) @ steady(reply))[:3, 3]))


def connected(outages: Outages, until: int = KNOWN) -> None:
    """Scans up to `until`, answered two scans late, as in lockstep."""
    for seq in range(1, until + 1):
        if seq > 2:
            outages.on_answer(answer(seq - 2))
        assert outages.on_frame(frame(seq)) == []


def alone(outages: Outages, first: int = KNOWN + 1, count: int = SILENT) -> list[OdometryReply]:
    """Scans without answers; what the Imu node is told meanwhile."""
    return [reply for seq in range(first, first + count) for reply in outages.on_frame(frame(seq))]


def test_with_answers_two_scans_late_nothing_is_done_and_no_answer_is_touched():
    outages = Outages(OdometrySettings())
    for seq in range(1, KNOWN):
        assert outages.on_frame(frame(seq)) == []
        if seq > 2:
            reply = answer(seq - 2)
            told, correction = outages.on_answer(reply)
            assert told is reply
            assert correction is None
    assert outages.report().count == 0


def test_a_gap_between_scans_is_no_outage():
    outages = Outages(OdometrySettings())
    connected(outages)
    outages.on_answer(answer(KNOWN - 1))
    later = frame(KNOWN + 30)  # three seconds without scans
    assert outages.on_frame(later) == []
    assert not outages.alone


def test_after_half_a_second_every_scan_is_placed_in_order_and_none_twice():
    outages = Outages(OdometrySettings())
    connected(outages)
    replies = alone(outages)
    assert outages.alone
    assert [reply.seq for reply in replies] == list(range(KNOWN - 1, KNOWN + SILENT + 1))
    assert {reply.state for reply in replies} == {UNANCHORED}
    assert max(map(off_m, replies)) < bars.EDGE_ODOMETRY_M
    wrong_m = 0.02 * SILENT  # what the predictions alone would have come to
    assert off_m(replies[-1]) < 0.1 * wrong_m
    assert outages.report().scans == {"placed": SILENT + 2, "degenerate": 0, "failed": 0}


def test_by_the_clock_the_age_of_frames_counts_and_not_their_stamps():
    now_ns = 0
    outages = Outages(OdometrySettings(), clock_ns=lambda: now_ns)
    connected(outages)
    assert alone(outages) == []  # a backlog that is worked off within no time at all
    now_ns = SCAN_NS * 5
    assert outages.on_frame(frame(KNOWN + SILENT + 1))


def test_what_the_imu_node_is_told_goes_on_when_the_service_is_back_and_the_map_takes_the_difference():
    outages = Outages(OdometrySettings())
    connected(outages)
    alone(outages)
    drift = se3.exp(np.array([0.0, 0.0, 0.02, 0.3, -0.2, 0.0]))  # of the service's frame against the robot's
    jump = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.4, 0.0]))  # a loop was closed meanwhile
    told = None
    for seq in range(KNOWN - 1, KNOWN + SILENT + 1):  # the back-fill
        _, correction = outages.on_answer(answer(seq, drift, jump))
        told = correction or told
    assert not outages.alone
    assert isinstance(told, Correction)
    assert told.translation_m == pytest.approx(np.linalg.norm((jump @ drift @ pose(seq) - pose(seq))[:3, 3]), abs=0.01)
    last = KNOWN + SILENT
    for seq in range(last + 1, last + 4):
        assert outages.on_frame(frame(seq)) == []
        reply, correction = outages.on_answer(answer(seq, drift, jump))
        assert correction is None
        assert reply is not None
        assert off_m(reply) < 2 * bars.EDGE_ODOMETRY_M  # the robot's own frame goes on
        np.testing.assert_allclose(reply.T_map_lidar, jump @ drift @ pose(seq))  # and `map` is the service's


def test_without_any_answer_the_edge_begins_where_it_stands_and_the_service_puts_it_on_the_map_later():
    outages = Outages(OdometrySettings())
    count, told = 40, None
    replies = alone(outages, first=1, count=count)
    assert outages.alone
    assert replies[0].seq == 2  # the first scan is what the others are matched against
    T_first = steady(replies[0]) @ se3.inv(pose(2))  # level as the first scan says; the walk begins elsewhere
    ends = [float(np.linalg.norm((se3.inv(T_first @ pose(r.seq)) @ steady(r))[:3, 3])) for r in replies]
    assert max(ends) < 2 * bars.EDGE_ODOMETRY_M
    for seq in range(1, count + 1):  # the service has it all at once, somewhere on an old map
        told, correction = outages.on_answer(answer(seq, se3.exp(np.array([0.0, 0.0, 1.0, 5.0, -3.0, 0.0]))))
        assert correction is None  # it has been nowhere before
    assert not outages.alone
    np.testing.assert_allclose(steady(told), T_first @ pose(count), atol=2 * bars.EDGE_ODOMETRY_M)


def test_a_service_that_does_not_know_where_the_robot_is_ends_no_outage():
    outages = Outages(OdometrySettings())
    alone(outages, first=1, count=40)
    for seq in range(1, 41):
        outages.on_answer(replace(answer(seq), state=LOST))
    assert outages.alone


def test_a_start_waits_two_seconds_for_its_service():
    outages = Outages(OdometrySettings())
    assert alone(outages, first=1, count=20) == []
    outages.on_answer(answer(18))
    assert alone(outages, first=21, count=1) == []
    assert outages.report().count == 0


def test_an_outage_after_an_outage_goes_on_in_the_same_frame():
    outages = Outages(OdometrySettings())
    connected(outages)
    alone(outages)
    drift = se3.exp(np.array([0.0, 0.0, 0.02, 0.3, -0.2, 0.0]))
    for seq in range(KNOWN - 1, KNOWN + SILENT + 1):
        outages.on_answer(answer(seq, drift))
    again = alone(outages, first=KNOWN + SILENT + 1)
    assert outages.report().count == 2
    assert max(map(off_m, again)) < 2 * bars.EDGE_ODOMETRY_M


def test_answers_that_are_always_late_move_the_map_and_not_the_robot():
    outages = Outages(OdometrySettings())
    connected(outages)
    drift, late = se3.exp(np.array([0.0, 0.0, 0.01, 0.1, 0.0, 0.0])), 8
    for seq in range(KNOWN + 1, KNOWN + 30):
        if seq - late > KNOWN:
            outages.on_answer(answer(seq - late, drift))
        replies = outages.on_frame(frame(seq))
    assert outages.alone
    (reply,) = replies
    assert off_m(reply) < bars.EDGE_ODOMETRY_M
    in_map = se3.inv(drift @ pose(reply.seq)) @ reply.T_map_lidar
    assert np.linalg.norm(in_map[:3, 3]) < 2 * bars.EDGE_ODOMETRY_M


@pytest.mark.parametrize("points", [0, 40])
def test_a_scan_of_too_few_points_is_carried_by_the_imu_and_counted(points: int):
    outages = Outages(OdometrySettings())
    connected(outages)
    before = alone(outages)[-1]
    blind = frame(before.seq + 1, points=points) if points else without_points(frame(before.seq + 1))
    (reply,) = outages.on_frame(blind)
    np.testing.assert_allclose(steady(reply), steady(before) @ blind.motion.T_prev_lidar, atol=1e-12)
    np.testing.assert_array_equal(reply.degenerate_axes, np.eye(6))  # the Imu node is not to believe it
    assert outages.report().scans["failed"] == 1
    assert np.trace(reply.covariance) > np.trace(before.covariance)


def test_a_robot_that_is_looked_for_from_its_first_scan_on_goes_by_its_own_odometry():
    outages = Outages(OdometrySettings())
    replies, place = [], se3.exp(np.array([0.0, 0.0, 1.0, 5.0, -3.0, 0.0]))
    for seq in range(1, KNOWN + 1):
        replies += outages.on_frame(frame(seq))
        told, correction = outages.on_answer(replace(answer(seq, place), state=LOST))
        assert correction is None
    assert outages.alone
    assert [reply.seq for reply in replies] == list(range(2, KNOWN + 1))
    assert {reply.state for reply in replies} == {LOST}  # whoever plans with it is told
    T_first = steady(replies[0]) @ se3.inv(pose(2))
    ends = [float(np.linalg.norm((se3.inv(T_first @ pose(r.seq)) @ steady(r))[:3, 3])) for r in replies]
    assert max(ends) < 2 * bars.EDGE_ODOMETRY_M
    outages.on_frame(frame(KNOWN + 1))
    told, correction = outages.on_answer(answer(KNOWN + 1, place))  # found
    assert not outages.alone
    assert correction is None
    np.testing.assert_allclose(steady(told), T_first @ pose(KNOWN + 1), atol=2 * bars.EDGE_ODOMETRY_M)


def test_a_robot_that_was_known_and_is_lost_goes_on_by_its_own_odometry_from_where_it_was_carried_to():
    outages = Outages(OdometrySettings())
    connected(outages)
    wrong = se3.exp(np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0]))  # what it was lost by
    replies = []
    for seq in range(KNOWN + 1, KNOWN + SILENT + 5):
        replies += outages.on_frame(frame(seq))
        told, correction = outages.on_answer(replace(answer(seq, wrong), state=LOST))
        assert correction is None
        assert (told is None) == outages.alone  # one of the two says where it is carried to
    assert outages.alone
    assert {reply.state for reply in replies} == {LOST}
    assert [reply.seq for reply in replies] == list(range(replies[0].seq, KNOWN + SILENT + 5))
    assert replies[0].seq - KNOWN < 12  # five answers, and the next dense scan
    ends = [float(np.linalg.norm((se3.inv(wrong @ pose(r.seq)) @ steady(r))[:3, 3])) for r in replies]
    assert max(ends) < 0.03 * 2 + bars.EDGE_ODOMETRY_M  # carried for a scan or two, and no more after it
    last = KNOWN + SILENT + 5
    outages.on_frame(frame(last))
    told, correction = outages.on_answer(answer(last))  # found
    assert not outages.alone
    assert correction is None
    assert told is not None
    np.testing.assert_allclose(steady(told), steady(replies[-1]) @ se3.inv(pose(last - 1)) @ pose(last), atol=0.02)
    np.testing.assert_allclose(told.T_map_lidar, pose(last))  # the robot's own frame goes on, `map` takes the rest


def test_a_few_answers_that_look_for_the_robot_are_no_reason_to_go_alone():
    outages = Outages(OdometrySettings())
    connected(outages)
    for seq in range(KNOWN + 1, KNOWN + 30):
        assert outages.on_frame(frame(seq)) == []
        outages.on_answer(replace(answer(seq), state=LOST if seq % 5 else 2))
    assert not outages.alone


def test_an_answer_to_a_scan_that_is_not_placed_yet_is_not_mixed_with_the_edge_s_own_poses():
    """A robot that is found just when the edge's odometry has begun, in a frame of its own."""
    outages = Outages(OdometrySettings())
    place = se3.exp(np.array([0.0, 0.0, 1.0, 5.0, -3.0, 0.0]))
    outages.on_frame(frame(1))
    for seq in range(2, 6):
        assert outages.on_frame(frame(seq)) == []
    outages.on_answer(replace(answer(1, place), state=LOST))
    told = outages.on_frame(frame(6))  # two of them are placed now, the others wait
    assert [reply.seq for reply in told] == [2, 3]
    assert outages.on_answer(answer(4, place)) == (None, None)
    assert outages.on_answer(answer(5, place)) == (None, None)
    told += outages.on_frame(frame(7))
    told += outages.on_frame(frame(8))
    joined, correction = outages.on_answer(answer(7, place))
    assert correction is None
    assert not outages.alone
    assert joined is not None
    steps = [se3.inv(steady(a)) @ steady(b) for a, b in itertools.pairwise([*told[:-1], joined])]
    made = [se3.inv(pose(seq - 1)) @ pose(seq) for seq in range(3, 8)]
    np.testing.assert_allclose(steps, made, atol=2 * bars.EDGE_ODOMETRY_M)


def test_switched_off_it_does_nothing():
    outages = Outages(OdometrySettings(enabled=False))
    connected(outages)
    assert alone(outages) == []


def test_the_doubt_grows_with_new_ground():
    outages = Outages(OdometrySettings(keyframes=4))
    connected(outages)
    replies = alone(outages, count=40)
    sigmas = [float(np.sqrt(np.trace(reply.covariance[3:, 3:]))) for reply in replies]
    assert sigmas[-1] > 1.5 * sigmas[0]
    assert off_m(replies[-1]) < 3 * sigmas[-1]


def test_outcomes_have_the_names_of_the_metric():
    assert set(Outages(OdometrySettings()).report().scans) == set(map(str, Outcome))
