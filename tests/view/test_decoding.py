"""From the wire's messages to what is shown."""

from __future__ import annotations

from typing import Any

from splitslam.view.decoding import scan_shown
from splitslam.wire import session_pb2 as pb
from splitslam.wire import types_pb2 as types
from splitslam.wire import view_pb2


def test_states_and_causes_of_a_later_service_are_shown_by_their_numbers() -> None:
    later: Any = 99
    correction = types.Correction(cause=later, translation_m=0.5)
    answer = pb.Odometry(seq=1, stamp_ns=5, pose_map_lidar=types.Transform(qw=1), state=later, correction=correction)
    shown = scan_shown(view_pb2.ScanSeen(answer=answer), 1.0)
    assert shown.state == "99"
    assert shown.correction is not None
    assert (shown.correction.cause, shown.correction.translation_m) == ("99", 0.5)
