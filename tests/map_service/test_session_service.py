"""SessionService, health, reflection and /metrics of a running service."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable

import grpc
import numpy as np
import pytest
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc

from splitslam.wire import session_pb2 as pb
from tests.map_service.fakes import FINAL_SHIFT_M, POINTS_LIDAR, payload
from tests.map_service.harness import Operator, Robot7, Service, frame, hello, new_run

Connect = Callable[..., Robot7]


@pytest.fixture
def service(shared_service: Service) -> Service:
    """One for all runs, each of which is new to it; a test that looks at all there is starts its own."""
    return shared_service


def drive(robot: Robot7, frames: int) -> None:
    for seq in range(1, frames + 1):
        robot.ask(frame(seq))
    robot.send(pb.Bye(last_seq=frames))
    robot.next("finished")


def test_sessions_are_listed_in_the_order_they_were_opened_and_by_site(service: Service, operator: Operator) -> None:
    known = len(operator.stub.List(pb.ListRequest()).sessions)
    runs = [(new_run(), site) for site in ("north", "south", "north")]
    for run_id, site in runs:
        robot = Robot7(service.address, hello(run_id, site_id=site))
        robot.next("welcome")
        robot.close()
    everything = operator.stub.List(pb.ListRequest()).sessions[known:]
    assert [s.run_id for s in everything] == [run_id for run_id, _ in runs]
    assert all(not s.finished and s.frames == 0 and s.epoch == 1 for s in everything)
    north = operator.stub.List(pb.ListRequest(site_id="north")).sessions
    assert [s.run_id for s in north] == [runs[0][0], runs[2][0]]


def test_the_trajectory_can_be_read_while_the_robot_drives(
    service: Service, connect: Connect, operator: Operator, session_id: str
) -> None:
    robot = connect(service)
    for seq in range(1, 8):
        robot.ask(frame(seq))
    while operator.get(session_id).durable_seq < 7:
        robot.next("credit")
    assert operator.poses(session_id) == [(seq, float(seq)) for seq in range(1, 8)]


def test_the_map_comes_corrected_one_keyframe_at_a_time(
    service: Service, connect: Connect, operator: Operator, session_id: str
) -> None:
    drive(connect(service), 7)
    pieces = list(operator.stub.StreamMap(pb.StreamMapRequest(session_id=session_id)))
    assert [p.keyframe for p in pieces] == [0, 1]
    points = np.frombuffer(pieces[1].points, "<f4").reshape(-1, 4)
    assert pieces[1].point_count == len(points) == len(POINTS_LIDAR)
    x_m = 6 + FINAL_SHIFT_M
    assert pieces[1].pose_map_lidar.tx_m == x_m
    np.testing.assert_allclose(points[:, :3], POINTS_LIDAR + [x_m, 0, 0], atol=0.003)
    assert points[:, 3].tolist() == [0, 1, 2]


def test_a_deleted_session_is_gone_and_the_answer_says_what_was_removed(
    service: Service, connect: Connect, operator: Operator, session_id: str
) -> None:
    drive(connect(service), 7)
    stored = operator.get(session_id)
    removed = operator.stub.Delete(pb.DeleteRequest(session_id=session_id))
    assert (removed.frames, removed.keyframes, removed.bytes) == (7, 2, stored.store_bytes)
    assert removed.bytes > 0
    assert session_id not in {session.session_id for session in operator.stub.List(pb.ListRequest()).sessions}
    with pytest.raises(grpc.RpcError, match="NOT_FOUND"):
        operator.get(session_id)
    assert connect(service).next("welcome").epoch == 1


def test_a_session_with_a_stream_is_not_deleted_but_one_that_is_only_held_is_and_starts_anew(
    service: Service, connect: Connect, operator: Operator, session_id: str
) -> None:
    robot = connect(service)
    robot.ask(frame(1))
    with pytest.raises(grpc.RpcError, match="FAILED_PRECONDITION"):
        operator.stub.Delete(pb.DeleteRequest(session_id=session_id))
    robot.close()
    while service.metrics()["splitslam_map_streams"]:
        time.sleep(0.02)
    operator.stub.Delete(pb.DeleteRequest(session_id=session_id))
    back = connect(service)
    welcome = back.next("welcome")
    assert (welcome.epoch, welcome.applied_seq) == (1, 0)
    assert back.ask(frame(1)).pose_map_lidar.tx_m == 1.0


@pytest.mark.parametrize(
    ("method", "request_"),
    [
        ("Get", pb.GetRequest),
        ("Delete", pb.DeleteRequest),
        ("Trajectory", pb.TrajectoryRequest),
        ("StreamMap", pb.StreamMapRequest),
    ],
)
def test_a_session_that_is_not_there_is_said_by_name(shared_service: Service, method: str, request_: Callable) -> None:
    operator = Operator(shared_service.address)
    session_id = f"rover-7/{uuid.uuid4()}"
    call = getattr(operator.stub, method)
    with pytest.raises(grpc.RpcError, match=f"no session '{session_id}'"):
        list(call(request_(session_id=session_id)))
    operator.close()


@pytest.mark.parametrize("voxel_m", [-1.0, 1e-6, float("nan")])
def test_a_voxel_size_that_makes_no_sense_is_refused(shared_service: Service, voxel_m: float) -> None:
    operator = Operator(shared_service.address)
    with pytest.raises(grpc.RpcError, match="voxel_m"):
        list(operator.stub.StreamMap(pb.StreamMapRequest(session_id="x", voxel_m=voxel_m)))
    operator.close()


def test_reflection_names_the_services(shared_service: Service) -> None:
    channel = grpc.insecure_channel(shared_service.address)
    stub = reflection_pb2_grpc.ServerReflectionStub(channel)
    request = reflection_pb2.ServerReflectionRequest(list_services="")
    (answer,) = stub.ServerReflectionInfo(iter([request]))  # pyright: ignore[reportCallIssue]
    names = {service.name for service in answer.list_services_response.service}
    assert {"splitslam.v1.EdgeService", "splitslam.v1.SessionService", "grpc.health.v1.Health"} <= names
    channel.close()


def test_metrics_count_frames_by_result_and_time_every_answer(
    start_service: Callable[..., Service], connect: Connect
) -> None:
    service = start_service()
    robot = connect(service)
    for seq, content in ((1, None), (2, None), (2, None), (3, payload("corrupt")), (4, None)):
        robot.ask(frame(seq, content))
    robot.wait_durable(4)
    committed = 'splitslam_map_commits_total{result="ok"}'
    service.wait_metrics(lambda page: page["splitslam_map_keyframes_total"] >= 1 and page[committed] >= 1, "the commit")
    for _ in range(3):  # the worker has told all that it counts, once at least, since the last answer
        robot.next("credit")
    metrics = service.metrics()
    assert metrics['splitslam_map_frames_total{result="mapped"}'] == 3
    assert metrics['splitslam_map_frames_total{result="duplicate"}'] == 1
    assert metrics['splitslam_map_frames_total{result="rejected"}'] == 1
    assert metrics['splitslam_map_rejected_total{reason="corrupt"}'] == 1
    assert metrics["splitslam_map_answer_seconds_count"] == 5
    assert metrics['splitslam_map_sessions{state="tracking"}'] == 1
    assert metrics["splitslam_map_streams"] == 1
    assert metrics["splitslam_map_keyframes_total"] == 1
    assert metrics['splitslam_map_commits_total{result="ok"}'] >= 1
    assert metrics["splitslam_map_commit_seconds_count"] >= 1
    assert metrics['splitslam_map_queue_frames{worker="0"}'] == 0


def test_the_frame_and_its_trace_id_are_in_the_log(service: Service, connect: Connect, run_id: str) -> None:
    """The one that came with it, or the one that both sides make of run and seq."""
    robot = connect(service)
    robot.ask(frame(1, trace_id=f"{run_id[:8]}ffffffff"))
    robot.ask(frame(2, trace_id=""))
    robot.ask(frame(3))
    assert f'"trace_id": "{run_id[:8]}ffffffff"' in service.log
    assert f'"trace_id": "{run_id[:8]}{2:08x}"' in service.log
