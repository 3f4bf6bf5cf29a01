"""The load generator's robots against a service that is slow to end a stream."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import grpc
import numpy as np

from splitslam.bench.load.fleet import Fleet
from splitslam.stack.reel import Reel
from splitslam.wire import session_pb2 as pb
from splitslam.wire import types_pb2 as types

FRAMES = 3
ENDS_AFTER_S = 0.3  # Finished; with many robots on a busy service it takes as long


def serve_robot(requests: Iterator[bytes], _context: grpc.ServicerContext) -> Iterator[bytes]:
    for body in requests:
        request = pb.StreamRequest.FromString(body)
        match request.WhichOneof("message"):
            case "hello":
                response = pb.StreamResponse(welcome=pb.Welcome())
            case "frame":
                frame, here = request.frame, types.Transform(qw=1.0)
                odometry = pb.Odometry(seq=frame.seq, stamp_ns=frame.stamp_ns, pose_map_lidar=here)
                response = pb.StreamResponse(odometry=odometry)
            case _:
                yield pb.StreamResponse(finished=pb.Finished(mapped=FRAMES)).SerializeToString()
                time.sleep(ENDS_AFTER_S)
                return
        yield response.SerializeToString()


@contextmanager
def service() -> Iterator[str]:
    """Its address."""
    with ThreadPoolExecutor(4) as threads:
        server = grpc.server(threads)
        stream = grpc.stream_stream_rpc_method_handler(serve_robot)
        server.add_generic_rpc_handlers(
            (grpc.method_handlers_generic_handler("splitslam.v1.EdgeService", {"Stream": stream}),)
        )
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        yield f"127.0.0.1:{port}"
        server.stop(None).wait()


def test_a_stream_that_the_service_ends_a_moment_after_finished_is_not_cut_by_the_robot():
    frames = [pb.Frame(seq=seq, stamp_ns=seq * 100) for seq in range(1, FRAMES + 1)]
    reel = Reel(pb.Hello(), frames, [np.eye(4)] * FRAMES)
    with service() as address:
        played = Fleet(address, reel, [0.0, 0.0], rate_hz=50.0).play(1.0, lambda: None)
    assert [account.wrong for account in played.accounts] == [[], []]
    assert [account.unanswered for account in played.accounts] == [0, 0]
