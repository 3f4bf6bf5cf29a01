"""An agent that meets an older service speaks the codec version that one reads, and its own again to the next."""

from __future__ import annotations

import logging

import pytest

from edge_agent.config import UplinkConfig
from edge_agent.dialogue import Dialogue
from edge_agent.metrics import EdgeMetrics
from splitslam import codec
from splitslam.robot import Robot, robot_for_service, robot_from_yaml
from splitslam.wire import session_pb2 as pb
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, made_frame
from tests.logs.said import said

PAYLOAD = codec.encode(made_frame(), ELEVATIONS_RAD, COLUMNS)
WHEELS = "wheels: {speed_noise_mps: 0.1}\n"


def dialogue(**hello: object) -> Dialogue:
    robot = robot_for_service(Robot(imu=None))
    fields = {"robot_file_yaml": robot, "beam_elevations_rad": ELEVATIONS_RAD.tolist(), **hello}
    return Dialogue(pb.Hello(**fields), UplinkConfig(window=99), EdgeMetrics())


def frame(seq: int, payload: bytes = PAYLOAD) -> pb.Frame:
    return pb.Frame(seq=seq, stamp_ns=seq, dense=True, codec_version=codec.CODEC_VERSION, payload=payload)


def sent_to(session: Dialogue, codec_version: int) -> pb.Frame:
    """What a service that reads up to that version gets on a new stream."""
    session.begin(0.0)
    hello = session.next_request(0.0)
    session.receive(pb.StreamResponse(welcome=pb.Welcome(codec_version=codec_version)), 0.0)
    request = session.next_request(0.0)
    assert hello is not None
    assert request is not None
    return request.frame


def test_the_same_frame_goes_out_as_each_service_reads_it() -> None:
    session = dialogue()
    session.keep(frame(1), 0.0)
    for reads, version in ((2, 2), (1, 1), (0, 2), (1, 1), (3, 2)):  # 0: the service does not say
        got = sent_to(session, reads)
        assert (got.codec_version, got.payload[0]) == (version, version)
        assert (got.seq, got.stamp_ns, got.dense) == (1, 1, True)
    assert got.payload == PAYLOAD


@pytest.mark.parametrize("bad", [{"payload": b"\x02rubbish"}, {"hello": {"robot_file_yaml": "lidar: 7"}}])
def test_a_frame_that_cannot_be_recoded_goes_as_it_is_and_is_told(bad: dict, caplog: pytest.LogCaptureFixture) -> None:
    session = dialogue(**bad.get("hello", {}))
    kept = frame(1, bad.get("payload", PAYLOAD))
    session.keep(kept, 0.0)
    with caplog.at_level(logging.WARNING):
        assert sent_to(session, 1) == kept
    event, fields = said(caplog)[-1]
    assert (event, fields["seq"], fields["codec_version"]) == ("frame not recoded", 1, 1)


def test_the_empty_frame_that_stands_for_a_lost_first_one_is_left_alone() -> None:
    session = dialogue()
    session.keep(frame(1, b""), 0.0)
    assert sent_to(session, 1).payload == b""


def test_the_service_hears_nothing_of_wheels() -> None:
    robot = robot_from_yaml(WHEELS)
    said = robot_for_service(robot)
    assert "wheels" not in said
    assert robot_from_yaml(said) == robot.model_copy(update={"wheels": None})


def test_the_service_hears_nothing_of_what_point_times_are_worth() -> None:
    said = robot_for_service(robot_from_yaml("lidar: {point_times: mirrored}"))
    assert "point_times" not in said
    assert robot_from_yaml(said).lidar.point_times == "given"
