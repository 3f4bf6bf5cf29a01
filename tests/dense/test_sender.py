"""From the robot's disk to the store, whatever is killed on the way."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import grpc
import pytest

from edge_agent.clouds.sender import CloudSender
from edge_agent.clouds.shelf import CloudShelf
from edge_agent.metrics import EdgeMetrics
from map_service.store import Store
from splitslam.security.client import Connector
from splitslam.security.settings import ClientTls
from splitslam.wire import dense_pb2 as pb
from splitslam.wire import dense_pb2_grpc as rpc
from splitslam.wire import session_pb2
from tests.dense.made import OpenLink, cloud, opening
from tests.dense.test_service import Connect, drive, stored
from tests.map_service.harness import STAMP_0_NS, Operator, Service

KEYFRAMES = (1, 6, 11)
A_NEWER_SERVICES_WORD = max(pb.CloudVerdict.values()) + 1


@contextmanager
def sending(shelf: CloudShelf, service: Service, link: OpenLink) -> Iterator[CloudSender]:
    connector = Connector(service.address, ClientTls())
    sender = CloudSender(shelf, link, service.address, connector, EdgeMetrics(keep=False), lambda size: None)
    sender.start()
    try:
        yield sender
    finally:
        sender.close()


def wait_until(condition: Callable[[], bool], within_s: float = 60.0) -> None:
    until_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < until_s
        time.sleep(0.01)


def filled(folder: Path, own: pb.UploadOpen, points: int = 300) -> CloudShelf:
    """With the clouds of three keyframes, and of one scan of which the agent never heard what it was."""
    before = CloudShelf(folder, 10**7, own)
    for seq in KEYFRAMES:
        before.put(seq, cloud(seq, points), is_key=True)
    before.put(8, cloud(8))
    return CloudShelf(folder, 10**7, own)


def test_every_keyframe_goes_up_and_leaves_the_disk_and_the_service_says_which_are_none(
    tmp_path: Path, service: Service, connect: Connect, run_id: str, session_id: str
) -> None:
    drive(service, connect, 12, bye=True)
    shelf = filled(tmp_path / "dense", opening(run_id))
    with sending(shelf, service, OpenLink()) as sender:
        wait_until(lambda: shelf.waiting == 0)
        assert sender.sent == 3
    assert not shelf.dropped
    assert not list((tmp_path / "dense").glob("*/*.*"))
    store = Store(service.store_url)
    assert stored(store, session_id) == {i: cloud(seq) for i, seq in enumerate(KEYFRAMES)}
    store.close()
    sent = sum(len(cloud(seq)) for seq in KEYFRAMES)
    assert sent < sender.tcp_bytes().sent < 1.2 * sent + 2000


def test_nothing_is_sent_while_the_link_has_better_things_to_do_or_the_service_does_not_know_it(
    tmp_path: Path, service: Service, connect: Connect, run_id: str
) -> None:
    drive(service, connect, 12, bye=True)
    shelf, link = filled(tmp_path / "dense", opening(run_id)), OpenLink()
    link.takes_dense = False
    with sending(shelf, service, link) as sender:
        time.sleep(0.6)
        link.idle, link.takes_dense = False, True
        time.sleep(0.6)
        assert (link.sent, sender.tcp_bytes().sent) == ([], 0)
        link.idle = True
        wait_until(lambda: shelf.waiting == 0)


@pytest.mark.parametrize(("limit_kbps", "largest"), [(None, 8192), (100.0, 3125), (1.0, 1024)])
def test_a_piece_takes_a_quarter_of_a_second_of_the_limit_at_most(
    tmp_path: Path,
    service: Service,
    connect: Connect,
    run_id: str,
    limit_kbps: float | None,
    largest: int,
) -> None:
    drive(service, connect, 12, bye=True)
    shelf, link = filled(tmp_path / "dense", opening(run_id), points=9000), OpenLink(limit_kbps)
    with sending(shelf, service, link):
        wait_until(lambda: shelf.waiting == 0)
    assert largest <= max(link.sent) < largest + 30


def test_a_service_that_is_killed_half_way_gets_every_scan_once(
    tmp_path: Path, start_service: Callable[..., Service], connect: Connect, run_id: str, session_id: str
) -> None:
    service = start_service()
    drive(service, connect, 12, bye=True)
    shelf, link = filled(tmp_path / "dense", opening(run_id), points=9000), OpenLink(1.0)
    link.most = 1.5 * len(cloud(1, 9000))
    with sending(shelf, service, link) as sender:
        wait_until(lambda: sum(link.sent) >= link.most)
        assert sender.sent == 1
        service.kill()
        time.sleep(0.3)
        service.start()
        link.most = float("inf")
        wait_until(lambda: shelf.waiting == 0, within_s=60.0)
        assert sender.sent == 3
    store = Store(service.store_url)
    assert stored(store, session_id) == {i: cloud(seq, 9000) for i, seq in enumerate(KEYFRAMES)}
    store.close()


def test_the_scans_of_a_session_that_was_deleted_are_given_up_and_counted(
    tmp_path: Path, service: Service, connect: Connect, run_id: str, session_id: str
) -> None:
    drive(service, connect, 12, bye=True)
    operator = Operator(service.address)
    operator.stub.Delete(session_pb2.DeleteRequest(session_id=session_id))
    operator.close()
    shelf = filled(tmp_path / "dense", opening(run_id))
    with sending(shelf, service, OpenLink()):
        wait_until(lambda: shelf.waiting == 0)
    assert shelf.dropped == {"deleted": 4}


class _PutsOff(rpc.DenseServiceServicer):
    """Every cloud may come later."""

    def __init__(self, verdict: int) -> None:
        self.verdict, self.offers = verdict, 0

    def Upload(self, request_iterator: Iterator[pb.UploadRequest], context: object) -> Iterator[pb.UploadResponse]:
        for request in request_iterator:
            if request.HasField("open"):
                yield pb.UploadResponse(verdict=pb.CLOUD_VERDICT_WANTED)
            else:
                self.offers += 1
                yield pb.UploadResponse(verdict=self.verdict, retry_after_ms=50)  # type: ignore[arg-type]


@pytest.mark.parametrize("verdict", [pb.CLOUD_VERDICT_NO_ROOM, A_NEWER_SERVICES_WORD])
def test_being_put_off_is_no_progress_that_the_end_of_a_run_waits_for(
    tmp_path: Path, run_id: str, verdict: int
) -> None:
    """What no word says that this agent knows is no refusal."""
    full, server = _PutsOff(verdict), grpc.server(ThreadPoolExecutor(2))
    rpc.add_DenseServiceServicer_to_server(full, server)
    address = f"127.0.0.1:{server.add_insecure_port('127.0.0.1:0')}"
    server.start()
    shelf = filled(tmp_path / "dense", opening(run_id))
    connector = Connector(address, ClientTls())
    sender = CloudSender(shelf, OpenLink(), address, connector, EdgeMetrics(keep=False), lambda size: None)
    began_s = sender.moved_s
    sender.start()
    try:
        wait_until(lambda: full.offers > 3 * shelf.waiting)
        assert shelf.waiting == 4
        assert sender.moved_s == began_s
        assert not shelf.dropped
    finally:
        sender.close()
        server.stop(None).wait()


def test_a_cloud_that_was_damaged_on_disk_is_counted_and_not_sent(
    tmp_path: Path, service: Service, connect: Connect, run_id: str, session_id: str
) -> None:
    drive(service, connect, 12, bye=True)
    shelf = filled(tmp_path / "dense", opening(run_id))
    file = tmp_path / "dense" / run_id / "00000006.key"
    file.write_bytes(file.read_bytes()[:-1] + b"x")
    with sending(shelf, service, OpenLink()) as sender:
        wait_until(lambda: shelf.waiting == 0)
        assert sender.sent == 2
    assert shelf.dropped == {"damaged": 1}


def test_of_what_a_killed_agent_had_in_hand_the_service_says_which_were_keyframes_and_they_are_counted(
    tmp_path: Path, service: Service, connect: Connect, run_id: str, session_id: str
) -> None:
    drive(service, connect, 12, bye=True)
    own = opening(run_id)
    killed = CloudShelf(tmp_path / "dense", 10**7, own)
    for seq in (*KEYFRAMES[1:], 8):
        killed.take(seq, STAMP_0_NS + seq * 100_000_000)
    killed.put(KEYFRAMES[0], cloud(KEYFRAMES[0]), is_key=True)
    shelf = CloudShelf(tmp_path / "dense", 10**7, own)
    with sending(shelf, service, OpenLink()) as sender:
        wait_until(lambda: not shelf.due(1e9))
        assert sender.sent == 1
    assert shelf.dropped == {"killed": len(KEYFRAMES) - 1}
    assert CloudShelf(tmp_path / "dense", 10**7, own).due(1e9) == []
    store = Store(service.store_url)
    assert stored(store, session_id) == {0: cloud(KEYFRAMES[0]), 1: None, 2: None}
    store.close()
