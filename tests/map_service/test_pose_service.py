"""PoseService of a running service: what is followed, what is told, what survives."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import grpc
import numpy as np
import pytest

from map_service.catalog import Catalog
from map_service.store import Store
from splitslam.map_client import MapClient, matrix
from splitslam.wire import pose_pb2 as pb
from splitslam.wire import pose_pb2_grpc as rpc
from splitslam.wire import session_pb2 as session_pb
from splitslam.wire import types_pb2 as types
from tests.conftest import ROOT
from tests.map_service.fakes import FINAL_SHIFT_M, POINTS_LIDAR, payload
from tests.map_service.harness import Robot7, Service, frame, hello, new_run
from tests.map_service.watching import WAIT_S, Follower, follow, kinds, of

Connect = Callable[..., Robot7]
LATE_S = 3.0  # the store's way: a commit a second, a look each half second, and a busy machine


@pytest.fixture
def service(shared_service: Service) -> Service:
    """One for all that leave it as it is; what is asked for without a name is asked for by site."""
    return shared_service


@pytest.fixture
def client(service: Service) -> Iterator[MapClient]:
    with MapClient(service.address) as made:
        yield made


@pytest.fixture
def stub(service: Service) -> Iterator[rpc.PoseServiceStub]:
    with grpc.insecure_channel(service.address) as channel:
        yield rpc.PoseServiceStub(channel)


def drive(robot: Robot7, first: int, last: int, **content: object) -> None:
    for seq in range(first, last + 1):
        robot.ask(frame(seq, payload(**content) if content else None))  # type: ignore[arg-type]


def bye(robot: Robot7, last: int) -> None:
    robot.send(session_pb.Bye(last_seq=last))
    robot.next("finished")


# -- WatchPoses -----------------------------------------------------------------------------------------------------


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
    assert answered_s < 1.0


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


# -- Events ---------------------------------------------------------------------------------------------------------


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
    command = [sys.executable, "examples/reanchor.py", service.address, session_id]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as example:
        if not late:
            time.sleep(1.0)
            end()
        printed, _ = example.communicate(timeout=WAIT_S)
    assert example.returncode == 0
    places = [float(line.split()[1]) for line in printed.splitlines()]
    assert places == pytest.approx([1.4 + FINAL_SHIFT_M, 6.4 + FINAL_SHIFT_M])


def test_the_page_shows_the_example_as_it_is() -> None:
    example = (ROOT / "examples" / "reanchor.py").read_text()
    assert f"```python\n{example}```" in (ROOT / "docs" / "api.md").read_text()
