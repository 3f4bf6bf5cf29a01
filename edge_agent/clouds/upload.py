"""One stream to DenseService: what is said is answered before the next thing is said, so little is ever under way."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from urllib.parse import quote

import grpc

from edge_agent.stream import ROUTE_KEY
from splitslam.security.client import Connector
from splitslam.wire import dense_pb2 as pb
from splitslam.wire import dense_pb2_grpc as rpc

LOWER_EFFORT = 1  # DSCP of RFC 8622: routers that know it let everything else go first
OPTIONS = [
    ("grpc.use_local_subchannel_pool", 1),
    ("grpc.enable_retries", 0),
    ("grpc.enable_http_proxy", 0),
    ("grpc.http2.bdp_probe", 0),
    ("grpc.dscp", LOWER_EFFORT),
    ("grpc.keepalive_time_ms", 10_000),  # a frozen service: the wait for its answer has no other end
    ("grpc.keepalive_timeout_ms", 5_000),
    ("grpc.http2.max_pings_without_data", 0),
]


class Upload:
    """A call on a channel. `say` raises grpc.RpcError when the call ends, also by `cancel` from another thread."""

    def __init__(self, channel: grpc.Channel, connector: Connector, opening: pb.UploadOpen, attempt: int) -> None:
        """attempt: as in Hello; each one more goes to another replica."""
        route = f"{quote(opening.robot_id, safe='')}/{opening.run_id}#{attempt}"
        self._requests: queue.SimpleQueue[pb.UploadRequest | None] = queue.SimpleQueue()
        metadata = ((ROUTE_KEY, route), *connector.metadata())
        self._call = rpc.DenseServiceStub(channel).Upload(self._iterate(), metadata=metadata)

    def _iterate(self) -> Iterator[pb.UploadRequest]:
        while (request := self._requests.get()) is not None:
            yield request

    def say(self, request: pb.UploadRequest) -> pb.UploadResponse:
        """The answer to it."""
        self._requests.put(request)
        return next(self._call)

    def cancel(self) -> None:
        """Whoever waits for an answer goes on at once."""
        self._requests.put(None)
        self._call.cancel()
