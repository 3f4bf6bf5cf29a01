"""A robot that sends what it should not: frames twice, too early, with flipped bits, and no message at all."""

from __future__ import annotations

import time
from collections.abc import Callable

import grpc

from splitslam.stack.reel import Reel
from splitslam.wire import session_pb2 as pb
from tests import tolerances as bars
from tests.chaos.invariants import Undisturbed, stored_poses
from tests.map_service.harness import Robot7

_PATIENCE_S = 30.0
_TWICE, _EARLY, _FLIPPED, _LAST = range(1, 16), 25, 16, 30


def be_rude(server: str, undisturbed: Undisturbed, expect: Callable[[bool, str], None]) -> None:
    """One session in a row of bad manners, finished at the end. `expect` is told what should hold."""
    reel = undisturbed.reel
    hello = reel.hello_of("rude")
    _twice_and_too_early(server, hello, reel, expect)
    robot, welcome = _welcomed(server, hello)
    applied_seq = welcome.applied_seq
    for seq in range(applied_seq + 1, _LAST + 1):
        answer = robot.ask(_flipped(_frame(reel, seq)) if seq == _FLIPPED else _frame(reel, seq))
        wanted = "corrupt" if seq == _FLIPPED else ""
        expect(answer.rejected == wanted, f"rude: frame {seq} rejected {answer.rejected!r}, expected {wanted!r}")
    robot.send(pb.Bye(last_seq=_LAST))
    robot.next("finished")
    robot.close()
    _no_message(server, expect)
    stored = stored_poses(server, f"rude/{hello.run_id}")
    seqs = [pose.seq for pose in stored]
    expect(seqs == [seq for seq in range(1, _LAST + 1) if seq != _FLIPPED], f"rude: stored {seqs}")
    off_m = max(abs(pose.pose.tx_m - reel.T_map_lidar[pose.seq - 1][0, 3]) for pose in stored)
    expect(off_m < bars.CHAOS_WORSE_M, f"rude: {off_m:.3f} m off for want of one frame")


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


def _twice_and_too_early(server: str, hello: pb.Hello, reel: Reel, expect: Callable[[bool, str], None]) -> None:
    robot, _ = _welcomed(server, hello)
    for seq in _TWICE:
        first, second = robot.ask(_frame(reel, seq)), robot.ask(_frame(reel, seq))
        same = second.pose_map_lidar == first.pose_map_lidar and second.pose_map_odom == first.pose_map_odom
        expect(second.duplicate and not first.duplicate and same, f"rude: frame {seq} sent twice: {first} {second}")
    robot.send(_frame(reel, _EARLY))
    status, wanted = robot.end(), f"expected seq {_TWICE.stop}"
    expect(status == grpc.StatusCode.ABORTED and wanted in robot.detail, f"rude: too early: {status} {robot.detail}")
    robot.close()


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
