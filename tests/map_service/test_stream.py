"""One robot's stream: opening, frames, answers, the end."""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Callable
from pathlib import Path

import grpc
import pytest

from map_service.integrity import Seen, findings
from map_service.store import Store
from splitslam.wire import session_pb2 as pb
from splitslam.wire import types_pb2 as types
from tests.map_service.fakes import FINAL_SHIFT_M, payload
from tests.map_service.harness import Held, Operator, Robot7, Service, frame, hello, new_run

Connect = Callable[..., Robot7]


@pytest.fixture
def service(shared_service: Service) -> Service:
    """One for all runs, each of which is new to it; a test that counts what has happened starts its own."""
    return shared_service


def test_frames_are_answered_in_order_and_the_run_ends_with_its_totals(
    service: Service, connect: Connect, operator: Operator, session_id: str
) -> None:
    robot = connect(service)
    welcome = robot.next("welcome")
    assert (welcome.epoch, welcome.durable_seq, welcome.applied_seq) == (1, 0, 0)
    assert (welcome.session_id, welcome.codec_version) == (session_id, 1)
    for seq in range(1, 13):
        robot.send(frame(seq))
    answers = [robot.next("odometry") for _ in range(12)]
    assert [a.seq for a in answers] == list(range(1, 13))
    assert [a.pose_map_lidar.tx_m for a in answers] == list(range(1, 13))
    assert [a.keyframe for a in answers] == [seq in (1, 6, 11) for seq in range(1, 13)]
    assert not any(a.duplicate or a.rejected for a in answers)
    assert answers[-1].applied_seq == 12
    assert answers[-1].pose_map_odom.tx_m == 0.5
    robot.send(pb.Bye(last_seq=12))
    finished = robot.next("finished")
    assert (finished.mapped, finished.keyframes) == (12, 3)
    assert robot.end() == grpc.StatusCode.OK
    assert operator.poses(session_id) == [(seq, seq + FINAL_SHIFT_M) for seq in range(1, 13)]


def test_a_finished_session_is_read_only(service: Service, connect: Connect) -> None:
    robot = connect(service)
    robot.ask(frame(1))
    robot.send(pb.Bye(last_seq=1))
    robot.next("finished")
    refused = connect(service).next("refused")
    assert (refused.reason, refused.retry_after_ms) == (pb.REFUSED_REASON_FINISHED, 0)


def test_a_duplicate_is_answered_with_its_stored_pose_and_not_mapped_again(service: Service, connect: Connect) -> None:
    robot = connect(service)
    for seq in range(1, 4):
        robot.ask(frame(seq))
    again = robot.ask(frame(2))
    assert (again.duplicate, again.seq, again.pose_map_lidar.tx_m, again.applied_seq) == (True, 2, 2.0, 3)
    assert robot.ask(frame(4)).pose_map_lidar.tx_m == 4.0


def test_a_gap_ends_the_stream_with_the_expected_seq_and_the_session_goes_on(
    service: Service, connect: Connect
) -> None:
    robot = connect(service)
    robot.ask(frame(1))
    robot.send(frame(3))
    assert robot.end() == grpc.StatusCode.ABORTED
    assert robot.detail == "expected seq 2, got 3"
    resumed = connect(service)
    welcome = resumed.next("welcome")
    assert (welcome.epoch, welcome.applied_seq) == (2, 1)
    assert [p.seq for p in welcome.last_poses] == [1]
    assert resumed.ask(frame(2)).pose_map_lidar.tx_m == 2.0


def test_a_hole_that_the_robot_declares_is_accepted_and_noted(
    start_service: Callable[..., Service], connect: Connect
) -> None:
    service = start_service()
    robot = connect(service)
    robot.ask(frame(1))
    after = frame(4)
    after.follows_seq = 1
    answer = robot.ask(after)
    assert (answer.seq, answer.applied_seq, answer.rejected) == (4, 4, "")
    robot.wait_durable(4)
    store = Store(service.store_url)
    assert not [line for line in findings(store, Seen()) if "missing" in line and "factor" not in line]
    store.close()
    undeclared = frame(7)
    undeclared.follows_seq = 5  # the robot still has 5: it must send it
    robot.send(undeclared)
    assert robot.end() == grpc.StatusCode.ABORTED


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ({"content": payload("corrupt")}, "corrupt"),
        ({"codec_version": 9}, "codec_version"),
        ({"stamp_ns": 5}, "time"),
    ],
)
def test_a_bad_frame_is_answered_as_rejected_and_the_session_goes_on(
    service: Service, connect: Connect, operator: Operator, session_id: str, bad: dict, reason: str
) -> None:
    robot = connect(service)
    robot.ask(frame(1))
    answer = robot.ask(frame(2, **bad))
    assert (answer.rejected, answer.seq, answer.applied_seq) == (reason, 2, 2)
    assert not answer.HasField("pose_map_lidar")
    assert robot.ask(frame(3)).pose_map_lidar.tx_m == 2.0
    assert robot.ask(frame(2)).rejected == reason
    robot.send(pb.Bye(last_seq=3))
    assert robot.next("finished").mapped == 2
    assert [seq for seq, _ in operator.poses(session_id)] == [1, 3]


def test_a_frame_that_the_pipeline_fails_on_ends_the_stream_once_and_is_rejected_then(
    service: Service, connect: Connect
) -> None:
    robot, before = connect(service), len(service.log)
    robot.ask(frame(1))
    robot.send(frame(2, payload("raise")))
    assert robot.end() == grpc.StatusCode.INTERNAL
    assert "RuntimeError: told to" in service.log[before:]
    resumed = connect(service)
    start = resumed.next("welcome").applied_seq + 1
    for seq in range(start, 2):
        resumed.ask(frame(seq))
    assert resumed.ask(frame(2, payload("raise"))).rejected == "failed"
    assert resumed.ask(frame(3)).pose_map_lidar.tx_m == 2.0


def test_a_frame_that_fails_after_its_answer_is_not_left_half_way_in_the_map(
    service: Service, connect: Connect
) -> None:
    robot = connect(service)
    robot.ask(frame(1))
    assert robot.ask(frame(2, payload("unsettled"))).pose_map_lidar.tx_m == 2.0
    assert robot.end() == grpc.StatusCode.INTERNAL
    assert "told to, after the answer" in service.log
    resumed = connect(service)
    for seq in range(resumed.next("welcome").applied_seq + 1, 2):
        resumed.ask(frame(seq))
    assert resumed.ask(frame(2, payload("unsettled"))).rejected == "failed"
    assert resumed.ask(frame(3)).pose_map_lidar.tx_m == 2.0


def test_credit_comes_twice_a_second_also_when_the_robot_says_nothing(service: Service, connect: Connect) -> None:
    robot = connect(service)
    robot.next("welcome")
    start_s = time.monotonic()
    for _ in range(4):
        assert robot.next("credit").window == 16
    assert time.monotonic() - start_s < 8.0  # 1.5 to 2 s where nothing else runs


def test_what_was_answered_becomes_durable_within_a_second_when_the_robot_stands(
    service: Service, connect: Connect
) -> None:
    robot = connect(service)
    for seq in range(1, 4):
        robot.ask(frame(seq))
    assert any(robot.next("credit").durable_seq == 3 for _ in range(6))


def test_more_frames_than_the_window_are_answered_all_the_same(service: Service, connect: Connect) -> None:
    robot = connect(service)
    for seq in range(1, 101):
        robot.send(frame(seq))
    assert [robot.next("odometry").pose_map_lidar.tx_m for _ in range(100)] == list(range(1, 101))


def test_a_robot_that_sends_more_than_its_window_is_not_read_any_further(
    service: Service, connect: Connect, tmp_path: Path
) -> None:
    robot, held = connect(service), Held(tmp_path)
    robot.next("welcome")
    robot.send(frame(1, held.content))
    for seq in range(2, 101):
        robot.send(frame(seq))
    waiting = 'splitslam_map_queue_frames{worker="0"}'
    service.wait_metrics(lambda page: page[waiting] >= 16, "a full window")
    robot.next("credit")
    assert service.metrics()[waiting] == 16
    held.end()
    assert [robot.next("odometry").seq for _ in range(100)] == list(range(1, 101))


def test_the_advice_of_the_configuration_follows_the_welcome(
    start_service: Callable[..., Service], connect: Connect
) -> None:
    robot = connect(start_service(advice={"max_kbps": 120}))
    robot.next("welcome")
    assert robot.next("advice").max_kbps == 120


def test_statistics_tell_costs_and_what_the_robot_has_lost(
    service: Service, connect: Connect, operator: Operator, session_id: str
) -> None:
    robot = connect(service)
    for seq in range(1, 7):
        robot.ask(frame(seq))
    robot.send(pb.EdgeReport(dropped_by_reason={"nan": 3}, spool_frames=2))
    robot.send(pb.Bye(last_seq=6))
    robot.next("finished")
    info = operator.get(session_id)
    statistics = json.loads(info.statistics_json)
    assert (info.finished, info.frames, info.keyframes, info.durable_seq) == (True, 6, 2, 6)
    assert statistics["edge"] == {"dropped": {"nan": 3}, "spool_frames": 2, "spool_bytes": 0}
    assert statistics["map_ms"]["graph"] == {"mean": 1.0}
    assert 0 < statistics["map_ms"]["total"]["mean"] <= statistics["map_ms"]["total"]["max"] < 1e3
    assert 0 < statistics["cpu_ms"] < 1e4


@pytest.mark.parametrize(
    ("changes", "reason", "detail"),
    [
        ({"wire_version": 2}, pb.REFUSED_REASON_VERSION, "wire version 2"),
        ({"codec_version": 0}, pb.REFUSED_REASON_VERSION, "codec version 0"),
        ({"robot_id": "../etc"}, pb.REFUSED_REASON_BAD_HELLO, "hello.robot_id"),
        ({"robot_id": "x" * 129}, pb.REFUSED_REASON_BAD_HELLO, "hello.robot_id"),
        ({"run_id": "yesterday"}, pb.REFUSED_REASON_BAD_HELLO, "hello.run_id"),
        ({"site_id": "a b"}, pb.REFUSED_REASON_BAD_HELLO, "hello.site_id"),
        ({"map_id": "hall"}, pb.REFUSED_REASON_BAD_HELLO, "hello.map_id"),
        ({"disable": ["wings"]}, pb.REFUSED_REASON_BAD_HELLO, "hello.disable 'wings'"),
        ({"deskew": "magic"}, pb.REFUSED_REASON_BAD_HELLO, "hello.deskew"),
        ({"robot_file_yaml": "lidar: {ringz: 3}"}, pb.REFUSED_REASON_BAD_HELLO, "ringz"),
        ({"robot_file_yaml": "x" * 70000}, pb.REFUSED_REASON_BAD_HELLO, "70000 characters"),
        ({"beam_elevations_rad": [0.1]}, pb.REFUSED_REASON_BAD_HELLO, "1 values"),
        ({"beam_elevations_rad": [float("nan")] * 16}, pb.REFUSED_REASON_BAD_HELLO, "beam_elevations_rad"),
    ],
)
def test_a_hello_that_cannot_be_served_is_refused_with_the_field_and_what_was_expected(
    shared_service: Service, run_id: str, changes: dict, reason: int, detail: str
) -> None:
    robot = Robot7(shared_service.address, hello(run_id, **changes))
    refused = robot.next("refused")
    assert (refused.reason, refused.retry_after_ms) == (reason, 0)
    assert detail in refused.detail
    assert robot.end() == grpc.StatusCode.OK
    robot.close()


def test_a_stream_that_does_not_begin_with_hello_is_refused(shared_service: Service) -> None:
    robot = Robot7(shared_service.address, pb.StreamRequest(frame=frame(1)))
    assert robot.next("refused").detail == "expected Hello as the first message of a stream"
    robot.close()


def test_fixes_that_cannot_be_used_are_counted_not_passed_on(service: Service, connect: Connect) -> None:
    unusable = 'splitslam_map_gnss_total{result="unusable"}'
    robot, before = connect(service), service.metrics()[unusable]
    fixes = [types.GnssFix(latitude_deg=float("nan")), types.GnssFix(covariance_enu_m2=[1.0])]
    assert robot.ask(frame(1, fixes=fixes)).rejected == ""
    for _ in range(3):
        robot.next("credit")
    assert service.metrics()[unusable] == before + 2


def test_a_session_of_a_later_release_is_sent_to_another_replica_and_not_touched(
    start_service: Callable[..., Service], connect: Connect, tmp_path: Path, session_id: str
) -> None:
    """In the middle of an upgrade, or of one that is taken back."""
    service = start_service()
    robot = connect(service)
    robot.ask(frame(1))
    robot.wait_durable(1)
    service.close()
    with sqlite3.connect(tmp_path / "map.db") as store:
        later = b'{"later": true}'
        assert store.execute("UPDATE sessions SET tracker = ?", [later]).rowcount == 1
    robot = connect(start_service())
    refused = robot.next("refused")
    assert (refused.reason, refused.retry_after_ms > 0) == (pb.REFUSED_REASON_VERSION, True)
    assert "the session is of another release: tracker state of version 9" in refused.detail
    with sqlite3.connect(tmp_path / "map.db") as store:
        assert store.execute("SELECT tracker, last_seq FROM sessions").fetchall() == [(later, 1)]


def test_a_stream_that_breaks_is_counted_by_its_end_and_leaves_no_traceback(
    start_service: Callable[..., Service], connect: Connect
) -> None:
    """By the robot; by us, for a gap; by a worker that dies. A Bye ends it well."""
    service = start_service()
    gone, gap, crash, well = (connect(service, run_id=new_run()) for _ in range(4))
    for robot in (gone, gap, crash, well):
        robot.ask(frame(1))
    gone.close()
    gap.send(frame(5))
    assert gap.end() == grpc.StatusCode.ABORTED
    well.send(pb.Bye(last_seq=1))
    assert well.end() == grpc.StatusCode.OK
    crash.send(frame(2, payload("crash", once=str(service.folder / "crashed"))))
    assert crash.end() == grpc.StatusCode.UNAVAILABLE
    ends = {"ok": 1, "cancelled": 1, "aborted": 1, "unavailable": 1}

    def counted(page: dict[str, float]) -> dict[str, float]:
        return {name: page[f'splitslam_map_stream_ends_total{{status="{name}"}}'] for name in ends}

    service.wait_metrics(lambda page: sum(counted(page).values()) >= len(ends), "each end counted")
    assert counted(service.metrics()) == ends
    log = [json.loads(line) for line in service.log.splitlines()]
    assert {line["status"] for line in log if line["event"] == "stream ended"} == set(ends)
    assert not [line for line in log if "exception" in line]
