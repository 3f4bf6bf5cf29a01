"""WatchScans of a running service: what a watcher gets, and that no robot ever waits for one."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import grpc
import numpy as np
import pytest

from map_service.view_service import MOST_WATCHERS
from splitslam.view.decoding import features, keyframe_poses
from splitslam.wire import session_pb2 as pb
from splitslam.wire import view_pb2, view_pb2_grpc
from tests.map_service.fakes import FINAL_SHIFT_M, KEYFRAME_EVERY, payload
from tests.map_service.harness import WAIT_S, Robot7, Service, frame

Connect = Callable[..., Robot7]
Call = Any


@contextmanager
def watching(service: Service, robot_id: str = "") -> Iterator[Call]:
    """The call; its first sign of life has come."""
    with grpc.insecure_channel(service.address, options=[("grpc.use_local_subchannel_pool", 1)]) as channel:
        request = view_pb2.WatchScansRequest(robot_id=robot_id)
        call = view_pb2_grpc.ViewServiceStub(channel).WatchScans(request, timeout=WAIT_S)
        assert not next(call).session_id
        yield call
        call.cancel()


def views(call: Call, count: int) -> list[view_pb2.WatchScansResponse]:
    """The next so many that are of a session."""
    found: list[view_pb2.WatchScansResponse] = []
    while len(found) < count:
        response = next(call)
        found += [response] if response.session_id else []
    return found


def test_a_watcher_sees_each_scan_with_its_features_and_what_they_were_matched_with(
    service: Service,
    connect: Connect,
    session_id: str,
) -> None:
    with watching(service) as call:
        robot = connect(service)
        answers = [robot.ask(frame(seq)) for seq in (1, 2, 3)]
        seen = views(call, 3)
    assert {view.session_id for view in seen} == {session_id}
    for view, answer in zip(seen, answers, strict=True):
        assert view.scan.answer == answer
        assert view.scan.frame_bytes == len(payload())
        assert view.answer_ms > 0
        shown, x = features(view.scan), float(answer.seq)
        assert shown.corners_lidar.tolist() == [[x, 0, 0]] * 2
        assert shown.correspondences_lidar(10).tolist() == [[[x, 0, 0], [x, 0, 1]]] * 2  # the surf has none


def test_who_comes_late_is_told_the_whole_map_and_then_only_what_moves(service: Service, connect: Connect) -> None:
    robot = connect(service)
    for seq in range(1, 2 * KEYFRAME_EVERY + 2):
        robot.ask(frame(seq))
    with watching(service) as call:
        robot.ask(frame(2 * KEYFRAME_EVERY + 2))
        robot.ask(frame(2 * KEYFRAME_EVERY + 3))
        first, second = views(call, 2)
        robot.send(pb.Bye(last_seq=2 * KEYFRAME_EVERY + 3))
        robot.next("finished")
        (end,) = views(call, 1)
    poses = keyframe_poses(first.map)
    assert {index: T[0, 3] for index, T in poses.items()} == {0: 1.0, 1: 6.0, 2: 11.0}
    assert list(first.map.loops) == [0, 2]
    assert np.frombuffer(first.map.fixes_map, "<f4").tolist() == [1.0, 0.0, 2.0]
    assert second.map == view_pb2.MapSeen()
    assert not end.HasField("scan")
    moved = keyframe_poses(end.map)
    assert {index: T[0, 3] - poses[index][0, 3] for index, T in moved.items()} == dict.fromkeys(range(3), FINAL_SHIFT_M)


def test_a_watcher_of_one_robot_is_shown_no_other(service: Service, connect: Connect) -> None:
    with watching(service, robot_id="rover-8") as other, watching(service, robot_id="rover-7") as this:
        connect(service).ask(frame(1))
        assert views(this, 1)[0].scan.answer.seq == 1
        begun_s = time.monotonic()
        assert not next(other).session_id  # a sign of life, a second later
        assert time.monotonic() - begun_s < 15.0


def test_a_watcher_that_hangs_keeps_no_robot_waiting_and_is_told_what_it_has_missed(
    service: Service,
    connect: Connect,
) -> None:
    frames = 300
    heavy = payload(points=20_000)  # a view of half a megabyte: more than any buffer on the way holds of so many
    before = service.metrics()["splitslam_map_views_missed_total"]
    with watching(service) as hanging:
        robot = connect(service)
        for seq in range(1, frames + 1):
            assert robot.ask(frame(seq, heavy)).seq == seq
        shown = missed = 0
        maps = []
        while shown + missed < frames:
            (view,) = views(hanging, 1)
            shown, missed = shown + 1, missed + view.missed
            maps.append(len(view.map.keyframes))
        assert shown + missed == frames
        assert missed == service.metrics()["splitslam_map_views_missed_total"] - before > 0
        robot.ask(frame(frames + 1))
        after = views(hanging, 1)[0]
        assert list(after.map.keyframes) == list(range(frames // KEYFRAME_EVERY + 1)), "all of the map anew"


def test_watching_goes_on_when_a_worker_has_died(start_service: Callable[..., Service], connect: Connect) -> None:
    service = start_service()
    with watching(service) as call:
        robot = connect(service)
        robot.ask(frame(1))
        robot.wait_durable(1)
        assert views(call, 1)[0].scan.answer.seq == 1
        os.kill(service.workers()[-1], signal.SIGKILL)
        robot.end()
        again = connect(service)
        again.next("welcome")
        again.ask(frame(2))
        assert views(call, 1)[0].scan.answer.seq == 2


def test_there_are_never_more_watchers_than_a_replica_can_bear(service: Service) -> None:
    calls = [watching(service) for _ in range(MOST_WATCHERS)]
    for call in calls:
        call.__enter__()
    with pytest.raises(grpc.RpcError, match=f"{MOST_WATCHERS} watch this replica already"), watching(service):
        pass
    assert service.metrics()["splitslam_map_viewers"] == MOST_WATCHERS
    calls[0].__exit__(None, None, None)
    deadline_s = time.monotonic() + WAIT_S
    while service.metrics()["splitslam_map_viewers"] != MOST_WATCHERS - 1:
        assert time.monotonic() < deadline_s
    with watching(service):
        pass
    for call in calls[1:]:
        call.__exit__(None, None, None)
