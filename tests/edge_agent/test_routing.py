"""Where a robot's next stream goes: where it was, or where it was told; elsewhere when that one is frozen or full."""

from __future__ import annotations

import time

from edge_agent.backoff import jittered
from splitslam.wire import session_pb2 as pb
from tests.edge_agent.fake_service import FakeService, Fault
from tests.edge_agent.test_uplink import PATIENT, SOON_S, frame, send_all, uplink_to


def test_after_a_stream_that_broke_the_robot_wants_the_replica_it_was_on():
    with FakeService(faults={3: Fault.KILL}, name="replica-a") as service, uplink_to(service.address) as uplink:
        send_all(uplink, 5)
    assert service.wishes == ["", "replica-a"]
    assert [hello.attempt for hello in service.hellos] == [0, 0]


def test_a_drained_robot_wants_the_replica_it_was_told_and_keeps_to_it():
    """The proxy says nothing when it has done as it was told: the second break is at the replica of the wish."""
    faults = {3: Fault.DRAIN, 9: Fault.KILL}
    with FakeService(faults=faults, drain_to="replica-b") as service, uplink_to(service.address) as uplink:
        send_all(uplink, 10)
    assert service.wishes == ["", "replica-b", "replica-b"]
    assert [hello.attempt for hello in service.hellos] == [0, 1, 1]


def test_a_silent_replica_is_not_wanted_again():
    settings, service = PATIENT.model_copy(update={"watchdog_s": SOON_S}), FakeService(faults={3: Fault.SILENT})
    service.name = "replica-a"
    with service, uplink_to(service.address, settings) as uplink:
        send_all(uplink, 5)
    assert service.wishes == ["", ""]
    assert [hello.attempt for hello in service.hellos] == [0, 1]


def test_silence_after_a_welcome_is_felt_in_its_time_however_long_the_welcome_might_have_taken():
    settings = PATIENT.model_copy(update={"welcome_timeout_s": 10.0, "watchdog_s": SOON_S})
    with FakeService(faults={1: Fault.SILENT}) as service, uplink_to(service.address, settings) as uplink:
        began_s = time.monotonic()
        send_all(uplink, 1)
        assert SOON_S <= time.monotonic() - began_s < 8.0
    assert len(service.hellos) == 2


def test_a_replica_that_refuses_is_left_at_once_and_not_wanted_again():
    refused = pb.Refused(reason=pb.REFUSED_REASON_OVERLOADED, retry_after_ms=50)
    service = FakeService(hello_replies=[pb.StreamResponse(refused=refused)], name="replica-a")
    with service, uplink_to(service.address) as uplink:
        uplink.wait_welcome()
    assert service.wishes == ["", ""]
    assert [key[-2:] for key in service.route_keys] == ["#0", "#1"]


def test_a_replica_that_builds_a_long_session_again_is_waited_for_as_long_as_it_gives_signs_of_life():
    settings = PATIENT.model_copy(update={"welcome_timeout_s": 1.0})
    service = FakeService(welcome_after_s=3.0, credit_s=0.1)
    with service, uplink_to(service.address, settings) as uplink:
        uplink.send(frame(1))
        assert uplink.wait_answered(1)
    assert len(service.hellos) == 1


def test_many_robots_that_are_told_the_same_time_come_back_one_after_the_other():
    waits_s = sorted(jittered(0.05) for _ in range(1000))
    assert 0.05 <= waits_s[0] < 0.055
    assert 0.095 < waits_s[-1] <= 0.1
    assert jittered(0.0) == 0.0
