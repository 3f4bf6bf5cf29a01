"""WatchPoses of a running service: what is followed, what is told, what survives."""

from __future__ import annotations

import time
from collections.abc import Callable

import grpc
import numpy as np
import pytest

from map_service.catalog import Catalog
from map_service.store import Store
from splitslam.map_client import MapClient, matrix
from splitslam.wire import pose_pb2 as pb
from splitslam.wire import pose_pb2_grpc as rpc
from splitslam.wire import types_pb2 as types
from tests.map_service.fakes import payload
from tests.map_service.harness import Robot7, Service, frame, hello, new_run
from tests.map_service.poses.driving import LATE_S, Connect, bye, drive
from tests.map_service.watching import Follower, follow, kinds, of


def test_each_scan_is_told_once_with_all_that_its_answer_said(
    service: Service, connect: Connect, client: MapClient, session_id: str
) -> None:
    robot = connect(service)
    answers = [robot.ask(frame(seq)) for seq in (1, 2)]
    follower = follow(client, session_id)
    follower.wait_seq(2)
    answers += [robot.ask(frame(seq, payload("corrupt") if seq == 5 else None)) for seq in range(3, 31)]
    follower.wait_seq(30)
    assert follower.seqs() == [seq for seq in range(1, 31) if seq != 5]
    told = {pose.seq: pose for pose in follower.poses}
    for answer in answers:
        if not answer.rejected:
            pose = told[answer.seq]
            assert (pose.stamp_ns, pose.state, pose.map_version) == (answer.stamp_ns, answer.state, answer.map_version)
            assert (pose.pose_map_lidar, list(pose.covariance)) == (answer.pose_map_lidar, list(answer.covariance))
            assert (pose.keyframe, pose.session_id) == (answer.keyframe, session_id)


def test_where_the_session_is_here_a_scan_is_told_before_it_is_stored(
    start_service: Callable[..., Service], connect: Connect, session_id: str
) -> None:
    service = start_service(commit={"every_s": 60.0, "every_frames": 10_000})
    robot = connect(service)
    drive(robot, 1, 6)  # the keyframe of scan 6 is not taken before the commit of scan 1 is
    with MapClient(service.address) as client:
        follower = follow(client, session_id)
        follower.wait(lambda f: bool(f.messages), "the first look")
        drive(robot, 7, 10)
        follower.wait_seq(10)
        assert follower.seqs() == list(range(1, 11))
        store = Store(service.store_url)
        row = Catalog(store).session(session_id)
        store.close()
    assert row is not None
    assert row.last_seq < 10


def test_the_body_is_where_the_robot_file_puts_it(service: Service, client: MapClient) -> None:
    lines = ["[1, 0, 0, 0.5]", "[0, 1, 0, 0]", "[0, 0, 1, -0.2]", "[0, 0, 0, 1]"]  # T_body_lidar
    run_id = new_run()
    greeting = hello(run_id)
    text = f"{greeting.robot_file_yaml}\n"
    start = text.index("T_body_lidar:")
    rest = text[start:].splitlines(keepends=True)
    kept = "".join(line for line in rest[1:] if not line.startswith((" ", "-")))
    greeting.robot_file_yaml = f"{text[:start]}T_body_lidar: [{', '.join(lines)}]\n{kept}"
    robot = Robot7(service.address, greeting)
    robot.ask(frame(1))
    live = follow(client, f"rover-7/{run_id}")
    live.wait_seq(1)
    robot.ask(frame(2))
    live.wait_seq(2)
    stored = client.pose_at(f"rover-7/{run_id}", frame(1).stamp_ns)
    for pose in (*live.poses, stored):
        T_body_lidar = np.linalg.inv(matrix(pose.pose_map_body)) @ matrix(pose.pose_map_lidar)
        np.testing.assert_allclose(T_body_lidar[:3, 3], [0.5, 0.0, -0.2], atol=1e-9)
    robot.close()


def test_from_now_on_leaves_out_what_was_and_tells_of_robots_that_come(service: Service, client: MapClient) -> None:
    early, late = (Robot7(service.address, hello(new_run(), robot_id=name)) for name in ("early", "late"))
    late.close()
    drive(early, 1, 6)
    early.wait_durable(6)
    follower = follow(client, from_start=False)
    follower.wait(lambda f: bool(f.messages), "the first look")
    late = Robot7(service.address, hello(run_id := new_run(), robot_id="late"))
    drive(early, 7, 8)
    drive(late, 1, 3)
    follower.wait_seq(3, f"late/{run_id}")
    follower.wait(lambda f: 8 in f.seqs(), "the next scan of the one that was there")
    early_id = next(pose.session_id for pose in follower.poses if pose.session_id.startswith("early"))
    assert follower.seqs(early_id) == [7, 8]
    assert follower.seqs(f"late/{run_id}") == [1, 2, 3]
    for robot in (early, late):
        robot.close()


def test_only_the_robots_and_sites_asked_for_are_told(service: Service, client: MapClient) -> None:
    robots = {
        name: Robot7(service.address, hello(new_run(), robot_id=name, site_id=site))
        for name, site in (("a", "north"), ("b", "north"), ("c", "south"))
    }
    for robot in robots.values():
        robot.ask(frame(1))
    asked = {
        "by robot": pb.SessionSelection(robot_ids=["a", "c"]),
        "by site": pb.SessionSelection(site_id="north"),
        "both": pb.SessionSelection(robot_ids=["a", "c"], site_id="north"),
    }
    expected = {"by robot": {"a", "c"}, "by site": {"a", "b"}, "both": {"a"}}
    followers = {how: Follower(client.watch_poses(selection, from_start=True)) for how, selection in asked.items()}
    for how, follower in followers.items():
        names = expected[how]
        follower.wait(lambda f, n=names: {p.session_id.partition("/")[0] for p in f.poses} >= n, how)
        assert {p.session_id.partition("/")[0] for p in follower.poses} == names
    for robot in robots.values():
        robot.close()


def test_a_correction_is_told_with_the_keyframes_that_it_moved_and_later_scans_have_the_next_version(
    service: Service, connect: Connect, client: MapClient, session_id: str
) -> None:
    robot = connect(service)
    drive(robot, 1, 7)
    follower = follow(client, session_id)
    follower.wait_seq(7)
    robot.ask(frame(8, payload("correct", by_m=0.4)))
    drive(robot, 9, 12)
    follower.wait(lambda f: bool(f.moved), "the move")
    (moved,) = follower.moved
    assert (moved.session_id, moved.move.map_version, moved.move.first_seq) == (session_id, 2, 9)
    assert (moved.move.cause, moved.move.translation_m) == (types.CORRECTION_CAUSE_LOOP, 0.4)
    assert [(k.keyframe, k.seq, k.pose_map_lidar.tx_m) for k in moved.keyframes][:2] == [(0, 1, 1.4), (1, 6, 6.4)]
    follower.wait_seq(12)
    assert [(p.seq, p.map_version) for p in follower.poses] == [(seq, 1 if seq < 9 else 2) for seq in range(1, 13)]


def test_a_service_that_is_killed_and_one_that_drains_cost_no_scan_and_give_none_twice(
    start_service: Callable[..., Service], connect: Connect, session_id: str
) -> None:
    service = start_service()
    with MapClient(service.address) as client:
        check_nothing_is_missed(service, connect, client, session_id)


def check_nothing_is_missed(service: Service, connect: Connect, client: MapClient, session_id: str) -> None:
    robot = connect(service)
    drive(robot, 1, 7)
    follower = follow(client, session_id)
    follower.wait_seq(7)
    events = Follower(client.events(of(session_id), from_start=True))
    for stop in (service.kill, service.terminate):
        stop()
        service.start()
        robot = connect(service)
        durable = robot.next("welcome").durable_seq
        last = durable + 9
        drive(robot, durable + 1, last)
        follower.wait_seq(last)
    robot.ask(frame(last + 1, payload("correct", by_m=1.0)))
    bye(robot, last + 1)
    for one in (follower, events):
        one.end()
        assert one.error is None
    assert follower.seqs() == list(range(1, last + 2))
    assert [event.number for event in events.events] == list(range(1, len(events.events) + 1))
    found = kinds(events.events)
    assert (found[0], found[-1], found.count("opened")) == ("opened", "ended", 3)
    assert [m.move.map_version for m in follower.moved][-1] == 3


def test_a_call_that_is_made_again_goes_on_after_its_cursor(
    service: Service, connect: Connect, stub: rpc.PoseServiceStub, session_id: str
) -> None:
    here = pb.SessionSelection(site_id="again")
    robot = connect(service, site_id="again")
    drive(robot, 1, 12)
    first = stub.WatchPoses(pb.WatchPosesRequest(sessions=here, from_start=True))
    seqs, cursor = [], ""
    for response in first:
        seqs += [pose.seq for pose in response.poses]
        cursor = response.cursor or cursor
        if cursor and seqs and seqs[-1] == 12:
            break
    first.cancel()
    drive(robot, 13, 14)
    bye(robot, 14)  # ended while nobody looked
    whole = Robot7(service.address, hello(new_run(), robot_id="meanwhile", site_id="again"))
    drive(whole, 1, 2)
    bye(whole, 2)
    whole.close()
    again = stub.WatchPoses(pb.WatchPosesRequest(sessions=here, cursor=cursor, after_seq={session_id: 12}))
    told: list[tuple[str, int]] = []
    for response in again:
        told += [(pose.session_id.partition("/")[0], pose.seq) for pose in response.poses]
        if len(told) >= 4:
            break
    again.cancel()
    assert sorted(told) == [("meanwhile", 1), ("meanwhile", 2), ("rover-7", 13), ("rover-7", 14)]


def test_a_reader_that_is_too_slow_loses_the_oldest_and_is_told_how_many_and_no_robot_waits(
    start_service: Callable[..., Service], connect: Connect, session_id: str
) -> None:
    service = start_service(watch={"backlog_scans": 100, "every_s": 0.1}, commit={"every_frames": 20})
    robot = connect(service)
    robot.ask(frame(1))
    options = [("grpc.http2.bdp_probe", 0), ("grpc.http2.lookahead_bytes", 1024), ("grpc.max_send_message_length", -1)]
    with grpc.insecure_channel(service.address, options) as channel:
        call = rpc.PoseServiceStub(channel).WatchPoses(pb.WatchPosesRequest(sessions=of(session_id), from_start=True))
        assert next(response for response in call if response.poses).poses[0].seq == 1
        answered_s = 0.0
        for seq in range(2, 2002):  # nobody reads meanwhile
            start_s = time.monotonic()
            robot.ask(frame(seq))
            answered_s = max(answered_s, time.monotonic() - start_s)
        robot.wait_durable(2001)
        told, dropped = [1], 0
        for response in call:
            told += [pose.seq for pose in response.poses]
            dropped = response.dropped
            if told[-1] == 2001:
                break
    assert told == sorted(set(told))
    assert dropped == 2001 - len(told)
    assert dropped > 0, "the reader was not slow"
    until_s = time.monotonic() + LATE_S
    while service.metrics()["splitslam_map_watch_dropped_scans_total"] != dropped:
        assert time.monotonic() < until_s
        time.sleep(0.05)
    assert answered_s < LATE_S


def test_there_is_a_sign_of_life_each_second_and_a_limit_to_how_many_follow(
    start_service: Callable[..., Service],
) -> None:
    service = start_service(watch={"most": 1})
    with MapClient(service.address) as client, grpc.insecure_channel(service.address) as channel:
        follower = follow(client)
        follower.wait(lambda f: len(f.messages) >= 3, "signs of life")
        assert max(np.diff(follower.at_s)) < LATE_S
        assert service.metrics()['splitslam_map_watchers{call="poses"}'] == 1
        with pytest.raises(grpc.RpcError, match="the limit is 1"):
            next(rpc.PoseServiceStub(channel).Events(pb.EventsRequest()))
