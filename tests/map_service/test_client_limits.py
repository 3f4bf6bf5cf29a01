"""What one robot may take of a replica; the others do not notice."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from map_service.callers import DeniedError
from map_service.client_limits import Bucket, ClientLimits, wait_turn
from map_service.config import ClientLimitsConfig
from splitslam.wire import session_pb2 as pb
from tests.map_service.harness import Robot7, Service, frame, hello, new_run

DENIED = 'splitslam_map_auth_refused_total{{reason="{}"}}'


def test_a_bucket_lets_a_burst_through_and_then_its_rate() -> None:
    bucket = Bucket(10.0, 3)
    assert [bucket.take() for _ in range(3)] == [0.0, 0.0, 0.0]
    assert bucket.take() == pytest.approx(0.1, abs=0.05)
    assert bucket.take() == pytest.approx(0.2, abs=0.05)


def test_openings_beyond_the_rate_are_denied_to_the_robot_that_makes_them_alone() -> None:
    limits = ClientLimits(ClientLimitsConfig(opens_per_s=0.001, opens_burst=3))
    for _ in range(3):
        with limits.stream("rover-1"):
            pass
    for _ in range(2):
        with pytest.raises(DeniedError) as denied, limits.stream("rover-1"):
            pass
        assert denied.value.reason == "opens"
    with limits.stream("rover-2"):
        pass


def test_streams_are_counted_while_they_are_open() -> None:
    limits = ClientLimits(ClientLimitsConfig(streams=2))
    with limits.stream("rover-1"), limits.stream("rover-1"):
        with pytest.raises(DeniedError) as denied, limits.stream("rover-1"):
            pass
        assert denied.value.reason == "streams"
        with limits.stream("rover-2"):
            pass
    with limits.stream("rover-1"):
        pass


def test_messages_beyond_the_rate_wait() -> None:
    async def waits() -> list[bool]:
        bucket = ClientLimits(ClientLimitsConfig(messages_per_s=2, messages_burst=2)).messages()
        return [await wait_turn(bucket) for _ in range(4)]

    assert asyncio.run(waits()) == [False, False, True, True]


def test_a_robot_too_many_streams_of_is_told_to_come_later_and_another_is_served(
    start_service: Callable[..., Service],
) -> None:
    service = start_service(limits={"client": {"streams": 1, "messages_per_s": 2, "messages_burst": 2}})
    first = Robot7(service.address, hello(new_run()))
    first.next("welcome")
    second, other = (
        Robot7(service.address, hello(new_run())),
        Robot7(service.address, hello(new_run(), robot_id="rover-8")),
    )
    try:
        refused = second.next("refused")
        assert (refused.reason, refused.retry_after_ms > 0) == (pb.REFUSED_REASON_OVERLOADED, True)
        other.next("welcome")
        for seq in range(1, 6):  # all at once, but they are taken no faster than the limit
            first.send(frame(seq))
        assert [first.next("odometry").applied_seq for _ in range(5)] == [1, 2, 3, 4, 5]
        metrics = service.metrics()
        assert metrics[DENIED.format("streams")] == 1
        assert metrics["splitslam_map_throttled_messages_total"] >= 2
    finally:
        for robot in (first, second, other):
            robot.close()
