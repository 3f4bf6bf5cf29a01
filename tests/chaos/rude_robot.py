"""A robot that sends what it should not: frames twice, too early, with flipped bits, and no message at all."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import grpc

from splitslam.stack.reel import Reel
from splitslam.wire import session_pb2 as pb
from tests import tolerances as bars
from tests.chaos.invariants import Undisturbed, stored_poses
from tests.map_service.harness import Robot7

_PATIENCE_S = 30.0
_EARLY_AFTER, _FLIPPED, _LAST = 15, 16, 30


class _MovedError(Exception):
    """The rack sends its robots elsewhere just now; the session goes on there."""


def be_rude(server: str, undisturbed: Undisturbed, expect: Callable[[bool, str], None]) -> None:
    """One session in a row of bad manners, finished at the end. `expect` is told what should hold."""
    reel = undisturbed.reel
    hello = reel.hello_of("rude")
    for part in (_twice, _too_early, _flips_bits):
        while not _got_through(part, server, hello, reel, expect):
            pass
    _no_message(server, expect)
    stored = stored_poses(server, f"rude/{hello.run_id}")
    seqs = [pose.seq for pose in stored]
    expect(seqs == [seq for seq in range(1, _LAST + 1) if seq != _FLIPPED], f"rude: stored {seqs}")
    off_m = max(abs(pose.pose.tx_m - reel.T_map_lidar[pose.seq - 1][0, 3]) for pose in stored)
    expect(off_m < bars.CHAOS_WORSE_M, f"rude: {off_m:.3f} m off for want of one frame")


def _got_through(part: Callable, server: str, hello: pb.Hello, reel: Reel, expect: Callable[[bool, str], None]) -> bool:
    """On one stream, from the frame after the last that is applied; False when the robot was moved meanwhile."""
    robot, welcome = _welcomed(server, hello)
    try:
        part(robot, welcome.applied_seq + 1, reel, expect)
    except _MovedError:
        return False
    finally:
        robot.close()
    return True


def _welcomed(server: str, hello: pb.Hello) -> tuple[Robot7, pb.Welcome]:
    """A rack that has just been hurt may refuse a new robot for a while; as any robot it asks again."""
    until_s = time.monotonic() + _PATIENCE_S
    while True:
        robot = Robot7(server, hello)
        first = robot.inbox.get(timeout=_PATIENCE_S)
        while first is not None and first.WhichOneof("message") == "credit":  # may come before
            first = robot.inbox.get(timeout=_PATIENCE_S)
        if first is not None and first.WhichOneof("message") == "welcome":
            return robot, first.welcome
        robot.close()
        assert time.monotonic() < until_s, f"rude: not let in: {first} {robot.status} {robot.detail}"
        time.sleep(0.5)


def _twice(robot: Robot7, next_seq: int, reel: Reel, expect: Callable[[bool, str], None]) -> None:
    for seq in range(next_seq, _EARLY_AFTER + 1):
        first, second = _ask(robot, _frame(reel, seq)), _ask(robot, _frame(reel, seq))
        same = second.pose_map_lidar == first.pose_map_lidar and second.pose_map_odom == first.pose_map_odom
        expect(second.duplicate and not first.duplicate and same, f"rude: frame {seq} sent twice: {first} {second}")


def _too_early(robot: Robot7, next_seq: int, reel: Reel, expect: Callable[[bool, str], None]) -> None:
    robot.send(_frame(reel, next_seq + 9))
    status, wanted = robot.end(), f"expected seq {next_seq}"
    if status == grpc.StatusCode.OK:
        raise _MovedError
    expect(status == grpc.StatusCode.ABORTED and wanted in robot.detail, f"rude: too early: {status} {robot.detail}")


def _flips_bits(robot: Robot7, next_seq: int, reel: Reel, expect: Callable[[bool, str], None]) -> None:
    for seq in range(next_seq, _LAST + 1):
        answer = _ask(robot, _flipped(_frame(reel, seq)) if seq == _FLIPPED else _frame(reel, seq))
        wanted = "corrupt" if seq == _FLIPPED else ""
        expect(answer.rejected == wanted, f"rude: frame {seq} rejected {answer.rejected!r}, expected {wanted!r}")
    robot.send(pb.Bye(last_seq=_LAST))
    _next(robot, "finished")


def _ask(robot: Robot7, frame: pb.Frame) -> pb.Odometry:
    robot.send(frame)
    return _next(robot, "odometry")


def _next(robot: Robot7, kind: str) -> Any:
    """The next response of this kind. Raises _MovedError where the stream ends as it does after `Drain`."""
    while (response := robot.inbox.get(timeout=_PATIENCE_S)) is not None:
        if response.WhichOneof("message") == kind:
            return getattr(response, kind)
    if robot.status == grpc.StatusCode.OK:
        raise _MovedError
    raise AssertionError(f"rude: the stream ended with {robot.status}: {robot.detail}")


def _no_message(server: str, expect: Callable[[bool, str], None]) -> None:
    with grpc.insecure_channel(server) as channel:
        call = channel.stream_stream("/splitslam.v1.EdgeService/Stream")(iter([b"\xff" * 100]))
        try:
            answers = [pb.StreamResponse.FromString(answer) for answer in call]
        except grpc.RpcError as error:
            expect(error.code() != grpc.StatusCode.UNKNOWN, f"rude: noise: {error}")  # pyright: ignore
            return
    reasons = [answer.refused.reason for answer in answers]
    expect(reasons == [pb.REFUSED_REASON_BAD_HELLO], f"rude: noise was answered with {answers}")


def _frame(reel: Reel, seq: int) -> pb.Frame:
    frame = pb.Frame()
    frame.CopyFrom(reel.frames[seq - 1])
    return frame


def _flipped(frame: pb.Frame) -> pb.Frame:
    payload = bytearray(frame.payload)
    payload[len(payload) // 2] ^= 0x10
    frame.payload = bytes(payload)
    return frame
