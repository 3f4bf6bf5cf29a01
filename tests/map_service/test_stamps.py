"""A session's stamps rise, whatever was rejected in between: readers find scans by them."""

from __future__ import annotations

import grpc

from tests.map_service.fakes import payload
from tests.map_service.harness import STAMP_0_NS, Service, frame
from tests.map_service.test_stream import Connect

ODOM_M = 0.5  # T_map_odom of the fake pipeline
DAY_NS = 86_400_000_000_000


def test_a_frame_that_is_rejected_says_nothing_of_the_time(service: Service, connect: Connect) -> None:
    robot = connect(service)
    robot.ask(frame(1))
    ahead = frame(2, payload("corrupt"), stamp_ns=STAMP_0_NS + DAY_NS)
    assert robot.ask(ahead).rejected == "corrupt"
    assert robot.ask(frame(3)).rejected == ""


def test_a_session_whose_newest_frames_were_all_rejected_goes_on_where_it_was_after_a_rebuild(
    service: Service, connect: Connect
) -> None:
    robot = connect(service)
    robot.ask(frame(1))
    newest = robot.ask(frame(2))
    for seq in range(3, 18):
        assert robot.ask(frame(seq, stamp_ns=5)).rejected == "time"
    robot.wait_durable(17)
    robot.send(frame(18, payload("raise")))  # which the service forgets the session for
    assert robot.end() == grpc.StatusCode.INTERNAL
    robot = connect(service)
    welcome = robot.next("welcome")
    assert (welcome.applied_seq, welcome.pose_map_odom.tx_m) == (17, ODOM_M)
    assert [pose.seq for pose in welcome.last_poses][-1:] == [newest.seq]
    assert robot.ask(frame(18)).rejected == "failed"
    assert robot.ask(frame(19, stamp_ns=newest.stamp_ns)).rejected == "time"
    assert robot.ask(frame(20, stamp_ns=newest.stamp_ns + 1)).rejected == ""
