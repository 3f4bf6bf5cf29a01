"""Events, PoseAt and LocalMap of a running service, and the example of the documentation."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator

import grpc
import numpy as np
import pytest

from splitslam.map_client import MapClient
from splitslam.wire import pose_pb2 as pb
from splitslam.wire import pose_pb2_grpc as rpc
from splitslam.wire import types_pb2 as types
from tests.conftest import ROOT
from tests.map_service.fakes import FINAL_SHIFT_M, POINTS_LIDAR, payload
from tests.map_service.harness import Robot7, Service, frame, hello, new_run
from tests.map_service.poses.driving import Connect, bye, drive
from tests.map_service.watching import WAIT_S, Follower, follow, kinds, of

WATCHING = 'splitslam_map_watchers{call="poses"}'


def test_what_happens_is_told_in_order_with_its_size_and_only_once_durable(
    service: Service, connect: Connect, client: MapClient, session_id: str
) -> None:
    robot = connect(service)
    robot.next("welcome")
    follower = Follower(client.events(of(session_id), from_start=True))
    drive(robot, 1, 7)
    robot.ask(frame(8, payload("correct", by_m=0.4)))
    drive(robot, 9, 9)
    bye(robot, 9)
    follower.end()
    events = follower.events
    assert kinds(events) == ["opened", "state", "loop", "map", "correction", "loop", "map", "ended"]
    assert [e.number for e in events] == list(range(1, 9))
    opened, state, loop, move, correction, _, last, ended = events
    assert (opened.opened.epoch, opened.seq) == (1, 0)
    assert state.state.before == types.TRACKING_STATE_INITIALISING
    assert state.state.after == types.TRACKING_STATE_TRACKING
    assert (loop.seq, loop.loop.newer_keyframe, loop.loop.translation_m) == (8, 1, 0.4)
    assert (move.seq, move.map.map_version, move.map.first_seq, move.map.translation_m) == (8, 2, 9, 0.4)
    assert (correction.seq, correction.correction.translation_m) == (9, 0.4)
    assert (last.map.map_version, last.map.translation_m) == (3, FINAL_SHIFT_M)
    assert (ended.seq, ended.ended.scans) == (9, 9)


def test_who_comes_back_with_a_cursor_has_missed_nothing_that_is_kept(
    service: Service, connect: Connect, stub: rpc.PoseServiceStub
) -> None:
    here = pb.SessionSelection(site_id="back")
    robot = connect(service, site_id="back")
    drive(robot, 1, 7)
    robot.wait_durable(6)
    call = stub.Events(pb.EventsRequest(sessions=here, from_start=True))
    first = next(call)
    call.cancel()
    assert kinds(first.events)[0] == "opened"
    bye(robot, 7)
    other = Robot7(service.address, hello(new_run(), robot_id="other", site_id="back"))
    drive(other, 1, 1)
    bye(other, 1)
    other.close()
    told, seen = list(first.events), first.cursor
    call = stub.Events(pb.EventsRequest(sessions=here, cursor=first.cursor))
    for response in call:
        told += response.events
        seen = response.cursor
        assert response.lost == 0
        if kinds(told).count("ended") == 2:
            break
    call.cancel()
    by_session: dict[str, list[int]] = {}
    for event in told:
        by_session.setdefault(event.session_id, []).append(event.number)
    assert len(by_session) == 2
    assert all(numbers == list(range(1, len(numbers) + 1)) for numbers in by_session.values())
    quiet = next(stub.Events(pb.EventsRequest(sessions=here, cursor=seen)))
    assert not quiet.events


def test_events_from_now_on_are_those_that_come(
    service: Service, connect: Connect, client: MapClient, session_id: str
) -> None:
    robot = connect(service)
    drive(robot, 1, 6)
    robot.wait_durable(6)
    follower = Follower(client.events())
    follower.wait(lambda f: bool(f.messages), "a sign of life")
    robot.ask(frame(7, payload("correct", by_m=0.4)))
    robot.ask(frame(8))
    follower.wait(lambda f: kinds(f.events) == ["loop", "map", "correction"], "the correction")


# -- PoseAt, LocalMap -----------------------------------------------------------------------------------------------


def test_pose_at_is_that_of_the_trajectory_now_and_what_was_answered_then(
    service: Service, connect: Connect, client: MapClient, session_id: str
) -> None:
    robot = connect(service)
    drive(robot, 1, 7)
    answer = robot.ask(frame(8, payload("correct", by_m=0.4)))
    drive(robot, 9, 12)
    bye(robot, 12)
    then = client.pose_at(session_id, answer.stamp_ns, answer.map_version)
    now = client.pose_at(session_id, answer.stamp_ns)
    assert then.pose_map_lidar.tx_m == answer.pose_map_lidar.tx_m == 8.0
    assert now.pose_map_lidar.tx_m == pytest.approx(8.4 + FINAL_SHIFT_M)
    between = client.pose_at(session_id, answer.stamp_ns, 2)
    assert between.pose_map_lidar.tx_m == pytest.approx(8.4)
    assert (now.map_version, now.newest_map_version, now.oldest_map_version) == (3, 3, 1)
    half_way = client.pose_at(session_id, answer.stamp_ns + 50_000_000)
    assert half_way.pose_map_lidar.tx_m == pytest.approx(8.9 + FINAL_SHIFT_M)
    assert (half_way.seq_before, half_way.seq_after) == (8, 9)
    for stamp_ns, version, said in ((0, 0, "begins at"), (answer.stamp_ns, 4, "known are 1 to 3")):
        with pytest.raises(grpc.RpcError, match=said) as error:
            client.pose_at(session_id, stamp_ns, version)
        assert error.value.code() == grpc.StatusCode.OUT_OF_RANGE  # type: ignore[attr-defined]


def test_the_local_map_is_what_lies_around_nearest_first_and_bounded(
    service: Service, connect: Connect, client: MapClient, session_id: str
) -> None:
    robot = connect(service)
    drive(robot, 1, 12)
    robot.wait_durable(12)

    def pieces(radius_m: float = 3.0, **options: object) -> list[tuple[int, np.ndarray]]:
        return list(client.local_map(session_id, radius_m, **options))

    found = pieces()  # around scan 12; keyframes lie at 1, 6 and 11 m
    assert [keyframe for keyframe, _ in found] == [2]
    np.testing.assert_allclose(found[0][1][:, :3], POINTS_LIDAR + [11, 0, 0], atol=0.003)
    assert [k for k, _ in pieces(radius_m=100.0)] == [2, 1, 0]
    at_6 = types.Transform(tx_m=6.0)
    assert [k for k, _ in pieces(pose_map_lidar=at_6, radius_m=5.5)] == [1, 0, 2]
    assert sum(len(points) for _, points in pieces(radius_m=100.0, max_points=4)) == 4
    assert sum(len(points) for _, points in pieces(radius_m=1.5, pose_map_lidar=at_6)) == 2  # one point is 2 m off
    thinned = pieces(voxel_m=0.5)
    assert sum(len(points) for _, points in thinned) == len(POINTS_LIDAR)
    assert sum(len(points) for _, points in pieces(voxel_m=10.0)) == 1


@pytest.mark.parametrize(
    ("method", "request_", "code", "said"),
    [
        ("WatchPoses", pb.WatchPosesRequest(sessions=of("r/none")), "NOT_FOUND", "no session 'r/none'"),
        ("WatchPoses", pb.WatchPosesRequest(cursor="soup"), "INVALID_ARGUMENT", "cursor 'soup': expected one of an"),
        ("Events", pb.EventsRequest(cursor='[1,{"a":-1}]'), "INVALID_ARGUMENT", "cursor"),
        ("Events", pb.EventsRequest(sessions=of(*["x"] * 101)), "INVALID_ARGUMENT", "session_ids: 101, expected at"),
        ("PoseAt", pb.PoseAtRequest(session_id="r/none"), "NOT_FOUND", "no session 'r/none'"),
        (
            "LocalMap",
            pb.LocalMapRequest(session_id="x", radius_m=500),
            "INVALID_ARGUMENT",
            "radius_m 500: expected 0.1",
        ),
        ("LocalMap", pb.LocalMapRequest(session_id="x", radius_m=float("nan")), "INVALID_ARGUMENT", "radius_m nan"),
        ("LocalMap", pb.LocalMapRequest(session_id="x", radius_m=1, voxel_m=-1), "INVALID_ARGUMENT", "voxel_m"),
        ("LocalMap", pb.LocalMapRequest(session_id="r/none", radius_m=1), "NOT_FOUND", "no session 'r/none'"),
    ],
)
def test_what_cannot_be_asked_is_one_line(
    shared_service: Service, method: str, request_: object, code: str, said: str
) -> None:
    def ask(call: Callable) -> object:
        answer = call(request_)
        return next(answer) if isinstance(answer, Iterator) else answer

    with grpc.insecure_channel(shared_service.address) as channel, pytest.raises(grpc.RpcError, match=said) as error:
        ask(getattr(rpc.PoseServiceStub(channel), method))
    assert error.value.code().name == code  # type: ignore[attr-defined]


def test_who_follows_from_the_start_of_a_session_that_has_ended_is_told_what_moved_after_its_scans(
    service: Service, connect: Connect, client: MapClient, session_id: str
) -> None:
    robot = connect(service)
    drive(robot, 1, 7)
    robot.ask(frame(8, payload("correct", by_m=0.4)))
    for first in range(9, 450, 20):  # more than a page of scans
        drive(robot, first, first + 19)
    bye(robot, first + 19)
    follower = follow(client, session_id)
    follower.end()
    assert follower.seqs() == list(range(1, first + 20))
    assert not follower.messages[-2].poses
    (moved,) = follower.moved
    assert (moved.move.map_version, moved.move.translation_m) == (3, FINAL_SHIFT_M)
    assert [k.keyframe for k in moved.keyframes] == list(range((first + 19 + 4) // 5))


@pytest.mark.parametrize("late", [False, True], ids=["while it drives", "once it has ended"])
def test_the_example_of_the_documentation_moves_what_was_seen(
    service: Service, connect: Connect, session_id: str, *, late: bool
) -> None:
    robot = connect(service)
    drive(robot, 1, 7)
    robot.wait_durable(6)

    def end() -> None:
        robot.ask(frame(8, payload("correct", by_m=0.4)))
        drive(robot, 9, 9)
        bye(robot, 9)

    if late:
        end()
    service.wait_metrics(lambda page: page[WATCHING] == 0, "nobody follows")
    command = [sys.executable, "examples/reanchor.py", service.address, session_id]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as example:
        if not late:
            service.wait_metrics(lambda page: page[WATCHING] == 1, "the example follows")
            end()
        printed, _ = example.communicate(timeout=WAIT_S)
    assert example.returncode == 0
    places = [float(line.split()[1]) for line in printed.splitlines()]
    assert places == pytest.approx([1.4 + FINAL_SHIFT_M, 6.4 + FINAL_SHIFT_M])


def test_the_page_shows_the_example_as_it_is() -> None:
    example = (ROOT / "examples" / "reanchor.py").read_text()
    assert f"```python\n{example}```" in (ROOT / "docs" / "api.md").read_text()
