"""The session protocol from the robot's side, against a service that misbehaves on purpose."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from edge_agent.config import UplinkConfig
from edge_agent.metrics import EdgeMetrics
from edge_agent.uplink import Uplink
from edge_agent.wire import Answer
from splitslam.errors import InputError
from splitslam.metrics import Family
from splitslam.stack.process import free_port, wait_until
from splitslam.wire import session_pb2 as pb
from tests.edge_agent.fake_service import FakeService, Fault
from tests.edge_agent.relay import CountingRelay
from tests.logs.said import said

# On a busy machine a service that is well takes its time: only where silence is the fault is a robot less patient.
PATIENT = UplinkConfig(
    welcome_timeout_s=5.0,
    welcome_timeout_max_s=10.0,
    watchdog_s=10.0,
    answer_timeout_s=10.0,
    connect_timeout_s=30.0,
    reconnect_timeout_s=30.0,
)
SOON_S = 2.0  # ten times what lies between two signs of life of a FakeService


@contextmanager
def uplink_to(address: str, settings: UplinkConfig = PATIENT, metrics: EdgeMetrics | None = None) -> Iterator[Uplink]:
    hello = pb.Hello(robot_id="röver 7", run_id="0b5c", wire_version=1)
    uplink = Uplink(address, hello, settings, metrics or EdgeMetrics())
    uplink.start()
    try:
        yield uplink
    finally:
        uplink.close()


def frame(seq: int, size: int = 2000, dense: bool = False) -> pb.Frame:
    return pb.Frame(seq=seq, stamp_ns=seq * 10**8, payload=bytes(seq % 256 for _ in range(size)), dense=dense)


def send_all(uplink: Uplink, count: int, first: int = 1) -> list[Answer]:
    for seq in range(first, first + count):
        uplink.send(frame(seq))
    assert uplink.wait_answered(first + count - 1)
    return uplink.take_answers()


def counted(family: Family) -> dict[str, float]:
    """What is not zero, by its label."""
    return {labels[0]: value for labels, value in family.values().items() if value}


def seqs(answers: list[Answer]) -> list[int]:
    return [answer.reply.seq for answer in answers]


def test_each_frame_is_answered_once_and_in_order():
    with FakeService() as service, uplink_to(service.address) as uplink:
        answers = send_all(uplink, 20)
        finished = uplink.finish(20)
    assert seqs(answers) == list(range(1, 21))
    assert [a.reply.T_map_lidar[0, 3] for a in answers] == [float(seq) for seq in range(1, 21)]
    assert finished is not None
    assert finished.mapped == 20
    assert service.holes == []
    assert service.route_keys == ["r%C3%B6ver%207/0b5c#0"]


@pytest.mark.parametrize(
    ("fault", "cause", "impatient"),
    [
        (Fault.KILL, "cancelled", {}),
        (Fault.KILL_AFTER, "cancelled", {}),
        (Fault.DRAIN, "drain", {}),
        (Fault.SILENT, "silent", {"watchdog_s": SOON_S}),
        (Fault.STUCK, "unanswered", {"answer_timeout_s": SOON_S}),
        (Fault.FORGET, "cancelled", {}),
    ],
)
def test_a_broken_stream_costs_no_frame_and_no_answer_twice(fault: Fault, cause: str, impatient: dict[str, float]):
    metrics = EdgeMetrics()
    service = FakeService(faults={8: fault})
    settings = PATIENT.model_copy(update=impatient)
    with service, uplink_to(service.address, settings, metrics) as uplink:
        answers = send_all(uplink, 20)
        assert uplink.finish(20) is not None
    assert seqs(answers) == list(range(1, 21))
    assert sorted(service.applied) == list(range(1, 21))
    assert service.holes == []
    assert len(service.hellos) == 2
    assert counted(metrics.reconnects) == {cause: 1.0}


def test_a_server_that_died_gets_the_frames_it_lost_again():
    service = FakeService(faults={8: Fault.FORGET})
    with service, uplink_to(service.address, PATIENT.model_copy(update={"window": 1})) as uplink:
        service.window = 1
        send_all(uplink, 20)
    # 5 was durable; 6 and 7 were answered but lost with the server
    assert service.received == [1, 2, 3, 4, 5, 6, 7, 8, 6, 7, 8, *range(9, 21)]


def test_a_frozen_replica_is_left_by_another_route_key():
    service = FakeService(hello_replies=[None])
    settings = PATIENT.model_copy(update={"welcome_timeout_s": SOON_S})
    with service, uplink_to(service.address, settings) as uplink:
        started_s = time.monotonic()
        uplink.wait_welcome()
        assert time.monotonic() - started_s < 15.0  # it would wait for ever
    assert [key[-2:] for key in service.route_keys] == ["#0", "#1"]
    assert [hello.attempt for hello in service.hellos] == [0, 1]


def test_a_refusal_with_a_time_is_retried_after_it():
    refused = pb.Refused(reason=pb.REFUSED_REASON_OVERLOADED, retry_after_ms=300)
    service = FakeService(hello_replies=[pb.StreamResponse(refused=refused)])
    with service, uplink_to(service.address) as uplink:
        started_s = time.monotonic()
        assert uplink.wait_welcome() is not None
        assert time.monotonic() - started_s >= 0.3


def test_a_refusal_for_good_is_one_line_that_says_why():
    refused = pb.Refused(reason=pb.REFUSED_REASON_VERSION, detail="wire version 1, expected 2")
    service = FakeService(hello_replies=[pb.StreamResponse(refused=refused)])
    with service, uplink_to(service.address) as uplink:
        with pytest.raises(InputError, match=r"^server 127.0.0.1:\d+: .*version.*wire version 1, expected 2$"):
            uplink.wait_welcome()
        with pytest.raises(InputError):
            uplink.send(frame(1))


def test_an_unreachable_server_is_one_line_that_names_it():
    port = free_port()
    settings = PATIENT.model_copy(update={"connect_timeout_s": 0.5})
    with uplink_to(f"127.0.0.1:{port}", settings) as uplink, pytest.raises(InputError) as caught:
        uplink.wait_welcome()
    assert f"127.0.0.1:{port}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_server_that_comes_up_late_is_waited_for():
    service = FakeService()
    with uplink_to(service.address) as uplink:
        time.sleep(0.3)
        with service:
            assert uplink.wait_welcome() is not None
            assert seqs(send_all(uplink, 3)) == [1, 2, 3]


def test_a_restarted_service_is_found_again_and_everything_is_answered():
    service = FakeService()
    with uplink_to_started(service) as uplink:
        send_all(uplink, 7)
        service.stop()
        service.forget()
        for seq in range(8, 30):
            uplink.send(frame(seq))
        assert not uplink.anchored
        service.start()
        assert uplink.wait_answered(29)
        assert seqs(uplink.take_answers()) == list(range(8, 30))
        assert uplink.finish(29) is not None
    service.stop()
    assert service.holes == []
    assert sorted(service.applied) == list(range(1, 30))


@contextmanager
def uplink_to_started(service: FakeService) -> Iterator[Uplink]:
    service.start()
    with uplink_to(service.address) as uplink:
        yield uplink


def test_an_outage_and_its_end_are_each_said_once(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("edge_agent.supervisor._TELL_S", 0.2)
    service = FakeService()
    with uplink_to_started(service) as uplink:
        send_all(uplink, 7)
        for first in (8, 15):
            service.stop()
            uplink.send(frame(first))
            wait_until(lambda: "does not answer" in caplog.text, 30.0, "the outage is said")
            time.sleep(0.3)  # it tries again
            service.start()
            assert uplink.wait_answered(first)
            assert [line for line, _ in said(caplog) if line.startswith("map service")] == [
                "map service does not answer: frames are kept until it does",
                "map service is there",
            ]
            caplog.clear()


def test_a_service_that_lost_durable_frames_ends_the_run_with_a_reason():
    service = FakeService()
    with uplink_to_started(service) as uplink:
        send_all(uplink, 12)
        service.stop()
        service.durable_seq = 0
        service.forget()
        service.start()
        with pytest.raises(InputError, match="stored up to scan 10 and now ends at 0"):
            uplink.finish(12)
    service.stop()


def test_unexpected_answers_are_counted_and_the_session_goes_on():
    metrics = EdgeMetrics()
    service = FakeService(faults={3: Fault.DUPLICATE, 5: Fault.WRONG_SEQ, 7: Fault.NAN})
    with service, uplink_to(service.address, metrics=metrics) as uplink:
        answers = send_all(uplink, 10)
    assert seqs(answers) == list(range(1, 11))
    assert [a.reply.seq for a in answers if a.reply.rejected] == [7]
    assert counted(metrics.ignored) == {"duplicate": 1.0, "unexpected": 1.0}


def test_a_lost_answer_to_bye_still_ends_the_run():
    service = FakeService()
    with service, uplink_to(service.address) as uplink:
        send_all(uplink, 3)
        service.finished = True
        stream = uplink._shared.stream
        assert stream is not None
        stream._call.cancel()
        assert uplink.finish(3) is not None


def test_an_outage_longer_than_the_buffer_drops_and_reports_but_goes_on():
    metrics = EdgeMetrics()
    service = FakeService()
    settings = PATIENT.model_copy(update={"buffer_bytes": 12_000})
    service.start()
    with uplink_to(service.address, settings, metrics) as uplink:
        send_all(uplink, 5)
        service.stop()
        wait_until(lambda: bool(counted(metrics.reconnects)), 30.0, "a broken stream")  # until then frames are sent
        for seq in range(6, 26):
            uplink.send(frame(seq, dense=seq % 10 == 0))
        assert metrics.dropped["buffer_full"] == 15
        uplink.report_drops(metrics.dropped)
        service.start()
        assert uplink.wait_answered(25)
        kept = seqs(uplink.take_answers())
        uplink.finish(25)
    service.stop()
    assert kept == [10, 20, 23, 24, 25]
    assert service.reports[-1].dropped_by_reason == {"buffer_full": 15}


@pytest.mark.parametrize(
    ("configured", "advice", "limit"),
    [(None, {"max_kbps": 120}, 120), (100, {"max_kbps": 120}, 100), (100, {"max_kbps": 80}, 80), (100, {}, 100)],
)
def test_the_lower_of_the_configured_and_the_advised_limit_holds(configured: float | None, advice: dict, limit: float):
    settings = PATIENT.model_copy(update={"max_kbps": configured})
    with FakeService(advice=pb.Advice(**advice)) as service, uplink_to(service.address, settings) as uplink:
        assert len(send_all(uplink, 3)) == 3
        assert uplink.limit_kbps == limit


def test_a_backlog_is_sent_within_the_limit():
    """13 frames of 2 kB wait when the service comes up: 32 kbit/s let 21 kB of them go at once, the rest in time."""
    settings = PATIENT.model_copy(update={"max_kbps": 32})
    with FakeService(window=64) as service:
        service.stop()
        with uplink_to(service.address, settings) as uplink:
            for seq in range(1, 14):
                uplink.send(frame(seq))
            assert uplink.backlog
            began_s = time.monotonic()
            service.start()
            assert uplink.wait_welcome()
            time.sleep(1.0)
            received, took_s = len(service.received), time.monotonic() - began_s
            assert 0 < 2000 * received < 21_000 + 4200 * took_s
            assert uplink.wait_answered(13)
            assert not uplink.backlog


def test_close_without_finish_leaves_the_session_open():
    service = FakeService()
    with service:
        with uplink_to(service.address) as uplink:
            send_all(uplink, 3)
        assert not service.finished


def test_the_kernel_s_byte_count_is_what_a_relay_sees():
    with FakeService() as service:
        relay = CountingRelay(("127.0.0.1", service.port))
        metrics = EdgeMetrics()
        with uplink_to(relay.address, metrics=metrics) as uplink:
            send_all(uplink, 30)
            relay.cut()
            send_all(uplink, 30, first=31)
            uplink.finish(60)
        counted = uplink.tcp_bytes()
        for seen, kernel in ((lambda: relay.up, counted.sent), (lambda: relay.down, counted.received)):
            wait_until(lambda s=seen, k=kernel: s() >= 0.98 * k, 30.0, "what the kernel has on its way")
        relay.close()
    assert counted.sent == pytest.approx(relay.up, rel=0.02)
    assert counted.received == pytest.approx(relay.down, rel=0.02)
    assert counted.sent > 60 * 2000


def test_bytes_are_counted_by_kind_as_serialized():
    metrics = EdgeMetrics()
    with FakeService() as service, uplink_to(service.address, metrics=metrics) as uplink:
        send_all(uplink, 3)
        uplink.finish(3)
    sent = counted(metrics._uplink)
    assert sent["frame"] == sum(pb.StreamRequest(frame=frame(seq)).ByteSize() for seq in (1, 2, 3))
    assert set(sent) == {"hello", "frame", "bye"}
