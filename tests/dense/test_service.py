"""DenseService over real gRPC: what is stored, once, and what is refused."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import closing

import grpc
import pytest

from map_service.catalog import Catalog
from map_service.store import Store
from splitslam import dense_cloud
from splitslam.wire import dense_pb2 as pb
from splitslam.wire import dense_pb2_grpc as rpc
from splitslam.wire import session_pb2
from tests.dense.made import cloud, opening, whole_scan
from tests.map_service.harness import Operator, Robot7, Service, frame, new_run

Connect = Callable[..., Robot7]
CALL_S = 20.0


def offer(seq: int, size: int, stamp_ns: int | None = None) -> pb.UploadRequest:
    stamp_ns = whole_scan(seq, 1).stamp_ns if stamp_ns is None else stamp_ns
    return pb.UploadRequest(offer=pb.CloudOffer(seq=seq, stamp_ns=stamp_ns, size=size))


def chunks(data: bytes, size: int = 200) -> list[pb.UploadRequest]:
    return [
        pb.UploadRequest(chunk=pb.CloudChunk(offset=at, data=data[at : at + size])) for at in range(0, len(data), size)
    ]


def upload(
    service: Service, run_id: str, requests: Iterable[pb.UploadRequest], site_id: str = ""
) -> list[pb.UploadResponse]:
    """The answers after that to UploadOpen."""
    said = [pb.UploadRequest(open=opening(run_id, site_id=site_id)), *requests]
    with grpc.insecure_channel(service.address) as channel:
        answers = list(rpc.DenseServiceStub(channel).Upload(iter(said), timeout=CALL_S))
    assert len(answers) == len(said)
    return answers[1:]


def verdicts(answers: list[pb.UploadResponse]) -> list[str]:
    return [pb.CloudVerdict.Name(answer.verdict).removeprefix("CLOUD_VERDICT_") for answer in answers]


def drive(service: Service, connect: Connect, frames: int, *, bye: bool = False) -> Robot7:
    robot = connect(service)
    assert robot.next("welcome").takes_dense
    for seq in range(1, frames + 1):
        robot.ask(frame(seq))
    if bye:
        robot.send(session_pb2.Bye(last_seq=frames))
        robot.next("finished")
    else:
        robot.wait_durable(frames)
    return robot


def refused(service: Service) -> float:
    return service.metrics()['splitslam_map_dense_clouds_total{verdict="refused"}']


def stored(store: Store, session_id: str) -> dict[int, bytes | None]:
    """Whole scans by keyframe."""
    catalog = Catalog(store)
    row = catalog.session(session_id)
    assert row is not None
    with closing(catalog.keyframes(row.id, dense=True)) as keyframes:
        return {keyframe.index: keyframe.dense for keyframe in keyframes}


def test_a_keyframes_scan_is_stored_byte_for_byte_and_once_also_after_the_run(
    url: str, start_service: Callable[..., Service], connect: Connect, run_id: str, session_id: str
) -> None:
    service = start_service(store=url)
    drive(service, connect, 12, bye=True)
    sent = cloud(6)
    store = Store(url)
    before = Catalog(store).session(session_id)
    requests = [offer(6, len(sent)), *chunks(sent)]
    answers = upload(service, run_id, requests)
    assert verdicts(answers) == ["WANTED"] * (len(answers) - 1) + ["STORED"]
    assert [answer.received_bytes for answer in answers[1:3]] == [200, 400]
    assert verdicts(upload(service, run_id, requests[:1])) == ["STORED"]
    assert stored(store, session_id) == {0: None, 1: sent, 2: None}
    row = Catalog(store).session(session_id)
    assert row is not None
    assert before is not None
    assert row.bytes == before.bytes + len(sent)
    metrics = service.metrics()
    assert metrics['splitslam_map_dense_clouds_total{verdict="stored"}'] == 2
    assert metrics["splitslam_map_dense_bytes_total"] == len(sent)
    operator = Operator(service.address)
    messages = list(operator.stub.StreamMap(session_pb2.StreamMapRequest(session_id=session_id, dense=True)))
    assert [bool(message.dense_cloud) for message in messages] == [False, True, False]
    assert [message.point_count > 0 for message in messages] == [True, False, True]
    assert operator.stub.Delete(session_pb2.DeleteRequest(session_id=session_id)).keyframes == 3
    operator.close()
    with store.reading() as connection:
        assert connection.exec_driver_sql("select count(*) from dense_clouds").scalar() == 0
    assert verdicts(upload(service, run_id, requests[:1])) == ["NO_SESSION"]
    store.close()


def test_what_the_map_does_not_need_is_said_before_a_byte_of_it_is_sent(
    service: Service, connect: Connect, run_id: str
) -> None:
    drive(service, connect, 12)
    asked = [
        offer(5, 100),  # no keyframe
        offer(6, 100, stamp_ns=17),  # another scan
        offer(100, 100),  # nobody knows yet
        offer(6, 0),
        offer(6, dense_cloud.MAX_BYTES + 1),
        offer(0, 100),
        offer(1 << 63, 100, stamp_ns=17),
        pb.UploadRequest(),
        pb.UploadRequest(chunk=pb.CloudChunk(offset=0, data=b"x")),
    ]
    before = refused(service)
    answers = upload(service, run_id, asked)
    assert verdicts(answers) == ["NOT_A_KEYFRAME", "NOT_A_KEYFRAME", "NOT_YET", *["REFUSED"] * 6]
    assert all("expected" in answer.detail for answer in answers[3:])
    assert refused(service) == before + 6
    assert verdicts(upload(service, new_run(), [offer(1, 100)])) == ["NO_SESSION"]


def test_bytes_that_are_no_cloud_of_that_scan_are_refused_and_the_next_cloud_is_taken(
    service: Service, connect: Connect, run_id: str
) -> None:
    drive(service, connect, 12)
    said_before = service.log.count('"event": "dense cloud refused"')
    good, other, damaged = cloud(6), cloud(1), bytearray(cloud(6))
    damaged[70] ^= 1
    first = chunks(good)[0]
    bad = [
        [offer(6, len(damaged)), *chunks(bytes(damaged), 5000)],
        [offer(6, len(other)), *chunks(other, 5000)],
        [offer(6, len(good)), first, first],  # twice the same
        [offer(6, len(good)), pb.UploadRequest(chunk=pb.CloudChunk(offset=0, data=b""))],
        [offer(6, 100), *chunks(good, 101)[:1]],
    ]
    said: list[pb.UploadRequest] = [request for requests in bad for request in requests]
    answers = upload(service, run_id, [*said, offer(6, len(good)), *chunks(good)])
    assert verdicts(answers).count("REFUSED") == len(bad)
    assert verdicts(answers)[-1] == "STORED"
    details = [answer.detail for answer in answers if answer.detail]
    assert [detail.split(":")[0].split(" at ")[0] for detail in details] == [
        "dense cloud", "dense cloud of frame 1, 6 was offered", "chunk of 200 bytes", "chunk of 0 bytes",
        "chunk of 101 bytes",
    ]  # fmt: skip
    assert service.log.count('"event": "dense cloud refused"') == said_before + len(bad)


@pytest.mark.parametrize(
    ("first", "why"),
    [
        (pb.UploadRequest(), "open.robot_id"),
        (pb.UploadRequest(open=pb.UploadOpen(robot_id="rover-7", run_id="1")), "open.run_id"),
        (pb.UploadRequest(open=pb.UploadOpen(robot_id="a/b", run_id=new_run())), "open.robot_id"),
        (pb.UploadRequest(offer=pb.CloudOffer(seq=1)), "open.robot_id"),
    ],
)
def test_who_does_not_say_whose_scans_they_are_is_told_so(service: Service, first: pb.UploadRequest, why: str) -> None:
    with grpc.insecure_channel(service.address) as channel, pytest.raises(grpc.RpcError) as raised:
        list(rpc.DenseServiceStub(channel).Upload(iter([first]), timeout=CALL_S))
    error = raised.value
    assert isinstance(error, grpc.Call)
    assert error.code() == grpc.StatusCode.INVALID_ARGUMENT
    assert why in str(error.details())


def test_scans_count_for_the_site_of_their_session_whatever_site_the_robot_names(
    start_service: Callable[..., Service], connect: Connect, run_id: str
) -> None:
    service = start_service(quota={"every_s": 0.01})
    robot = connect(service, site_id="north")
    for seq in range(1, 13):
        robot.ask(frame(seq))
    robot.wait_durable(12)
    service.close()
    service.settings["quota"]["sites"] = {"north": 500}
    service.start()
    for named in ("north", "south", ""):
        (answer,) = upload(service, run_id, [offer(6, 100)], site_id=named)
        assert verdicts([answer]) == ["NO_ROOM"], named


def test_a_site_at_its_quota_keeps_its_scans_on_the_robot(
    start_service: Callable[..., Service], connect: Connect, run_id: str
) -> None:
    service = start_service(quota={"site_bytes": 1_000_000, "every_s": 0.01, "retry_after_s": 7.0})
    drive(service, connect, 12)
    service.close()
    service.settings["quota"]["site_bytes"] = 500
    service.start()
    (answer,) = upload(service, run_id, [offer(6, 100)])
    assert verdicts([answer]) == ["NO_ROOM"]
    assert answer.retry_after_ms == 7000
    assert "its quota is 500" in answer.detail
