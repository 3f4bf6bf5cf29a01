"""One bidirectional stream to the map service, from Hello to its end; uplink.py knows what to say on it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from urllib.parse import quote

import grpc

from edge_agent.ending import Ending
from splitslam.security.client import Connector
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc

ROUTE_KEY = "splitslam-route-key"
REPLICA = "splitslam-replica"  # as Drain.replica said; without it the route key decides
_log = logging.getLogger(__name__)
_OPTIONS = [
    ("grpc.use_local_subchannel_pool", 1),  # each attempt gets a connection of its own, not the frozen one again
    ("grpc.enable_retries", 0),
    ("grpc.enable_http_proxy", 0),
    ("grpc.http2.bdp_probe", 0),  # pings for a window that a few kilobytes never fill
]


def route_key(hello: pb.Hello) -> str:
    """What the proxy hashes; header values are ASCII, robot ids need not be."""
    return f"{quote(hello.robot_id, safe='')}/{hello.run_id}#{hello.attempt}"


class Stream:
    """Opens at once. `next_request` blocks for the next message and returns None at the end of the stream.

    replica: where it shall go, "" for anywhere; once the service has spoken, where it is.
    `on_response` and `on_end` are called on this stream's reader thread; `on_end` once, with gRPC's reason.
    """

    def __init__(
        self,
        connector: Connector,
        hello: pb.Hello,
        replica: str,
        next_request: Callable[[Stream], pb.StreamRequest | None],
        on_response: Callable[[Stream, pb.StreamResponse], None],
        on_end: Callable[[Stream, Ending], None],
    ) -> None:
        self._connector = connector
        self._next_request, self._on_response, self._on_end = next_request, on_response, on_end
        self.replica = replica
        self._channel = connector.channel(_OPTIONS)
        wish = ((REPLICA, replica),) if replica else ()
        metadata = ((ROUTE_KEY, route_key(hello)), *wish, *connector.metadata())
        self._call = rpc.EdgeServiceStub(self._channel).Stream(self._requests(), metadata=metadata)
        self._reader = threading.Thread(target=self._read, name="uplink-reader", daemon=True)
        self._reader.start()

    def _requests(self) -> Iterator[pb.StreamRequest]:
        while (request := self._next_request(self)) is not None:
            yield request

    def _read(self) -> None:
        ending, heard = Ending("ended_by_server", "ended by the server"), False
        try:
            for response in self._call:
                if not heard:  # now the proxy's word is there; none: it did as it was told
                    self.replica = str(dict(self._call.initial_metadata()).get(REPLICA, self.replica))
                    heard = True
                self._on_response(self, response)
        except grpc.RpcError as error:
            ending = _ending(error, self._connector, heard)
        except Exception:  # a defect of ours must break the stream loudly, not leave it silent
            _log.exception("uplink reader failed")
            ending = Ending("internal", "internal error")
        self._on_end(self, ending)

    def close(self) -> None:
        """Cancels what is left and waits for the reader."""
        self._call.cancel()
        self._reader.join()
        self._channel.close()


def _ending(error: grpc.RpcError, connector: Connector, heard: bool) -> Ending:
    """heard: the service had said something."""
    if isinstance(error, grpc.Call):
        status, said = error.code().name, str(error.details())
        return Ending(status.lower(), f"{status}: {said}{connector.trouble(not heard and 'Socket closed' in said)}")
    return Ending("unknown", f"{error}{connector.trouble()}")
