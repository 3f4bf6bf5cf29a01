"""What the session protocol makes of each message, without a wire."""

from __future__ import annotations

from typing import Any

import pytest

from edge_agent.dialogue import Dialogue
from edge_agent.metrics import EdgeMetrics
from splitslam.wire import session_pb2 as pb
from splitslam.wire import types_pb2 as types
from tests.edge_agent.test_uplink import PATIENT, frame


def test_a_wish_for_a_dense_frame_does_not_lift_the_advised_limit():
    dialogue = Dialogue(pb.Hello(), PATIENT, EdgeMetrics())
    for advice, limit in ((pb.Advice(max_kbps=120), 120), (pb.Advice(want_dense=True), 120), (pb.Advice(), None)):
        dialogue.receive(pb.StreamResponse(advice=advice), 0.0)
        assert dialogue.limit_kbps == limit


def test_a_credit_before_the_welcome_is_a_sign_of_life_and_takes_nothing_back():
    """It says durable_seq 0, as its service has not read the session yet."""
    dialogue = Dialogue(pb.Hello(), PATIENT, EdgeMetrics())
    for seq in range(1, 5):
        dialogue.keep(frame(seq), 0.0)
    dialogue.begin(0.0)
    dialogue.receive(pb.StreamResponse(welcome=pb.Welcome(epoch=1)), 0.0)
    assert asked(dialogue) == ["hello", 1, 2, 3, 4]
    for seq in (1, 2, 3):
        answer = pb.Odometry(seq=seq, pose_map_lidar=types.Transform(qw=1), applied_seq=seq, durable_seq=2)
        dialogue.receive(pb.StreamResponse(odometry=answer), 0.0)
    stream = dialogue.begin(0.0)
    dialogue.keep(frame(5), 0.0)
    assert asked(dialogue) == ["hello"]
    dialogue.receive(pb.StreamResponse(credit=pb.Credit(window=16)), 1.0)
    assert (stream.last_message_s, dialogue.outbox.durable_seq, len(dialogue.outbox)) == (1.0, 2, 3)
    assert asked(dialogue) == [], "nothing is sent before the Welcome"
    dialogue.receive(pb.StreamResponse(welcome=pb.Welcome(epoch=2, durable_seq=2, applied_seq=3)), 1.0)
    assert asked(dialogue) == [4, 5]
    assert dialogue.failure is None


@pytest.mark.parametrize("retry_after_ms", [0, 70])
def test_reasons_of_a_later_service_mean_what_they_say_of_trying_again(retry_after_ms: int):
    """Protobuf's enums are open: a number that has no name here is no error."""
    later: Any = 99
    dialogue = Dialogue(pb.Hello(), PATIENT, EdgeMetrics())
    stream = dialogue.begin(0.0)
    refused = pb.Refused(reason=later, detail="why", retry_after_ms=retry_after_ms)
    dialogue.receive(pb.StreamResponse(refused=refused), 0.0)
    if retry_after_ms:
        assert (stream.retry_after_s, str(stream.ended), dialogue.failure) == (0.07, "refused (99): why", None)
    else:
        assert dialogue.failure == "the map service refused the session (99): why"
    drain = pb.Drain(reason=later, replica="b", retry_after_ms=retry_after_ms)
    stream = dialogue.begin(0.0)
    dialogue.receive(pb.StreamResponse(drain=drain), 0.0)
    assert (dialogue.replica, stream.other_replica, str(stream.ended)) == ("b", True, "drain: 99")


def asked(dialogue: Dialogue) -> list[int | str]:
    """Everything that it has to say now: a frame by its seq, the rest by name."""
    said: list[int | str] = []
    while (request := dialogue.next_request(0.0)) is not None:
        kind = str(request.WhichOneof("message"))
        said.append(request.frame.seq if kind == "frame" else kind)
    return said
