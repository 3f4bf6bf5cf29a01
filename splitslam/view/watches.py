"""WatchScans on every replica of a service: one thread each, all into one bounded queue.

While nobody takes from the queue nothing is read from the connections, and the service drops what we do not read: it
keeps no robot waiting for us, and nothing piles up here.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import grpc

from splitslam.security.client import Connector
from splitslam.wire import view_pb2, view_pb2_grpc

ANY = ""  # whichever replica the proxy chooses
_REPLICA = "splitslam-replica"  # metadata: which one it shall be
_OPTIONS = (
    ("grpc.max_receive_message_length", -1),
    ("grpc.keepalive_time_ms", 10_000),
    ("grpc.keepalive_timeout_ms", 5_000),
)
_QUEUED = 256
_RETRY_S, _PUT_S = 0.5, 0.2
_FINAL = (grpc.StatusCode.PERMISSION_DENIED, grpc.StatusCode.UNIMPLEMENTED, grpc.StatusCode.INVALID_ARGUMENT)


@dataclass(frozen=True, slots=True)
class Seen:
    """A message of the watch on one replica."""

    watch: str
    response: view_pb2.WatchScansResponse


@dataclass(frozen=True, slots=True)
class Trouble:
    """A connection that ended. final: asking again does not help."""

    text: str
    final: bool


class Watches:
    """`items` has Seen and Trouble, and whatever others put there."""

    def __init__(self, connector: Connector, request: view_pb2.WatchScansRequest) -> None:
        self.items: queue.Queue[Any] = queue.Queue(_QUEUED)
        self._connector, self._request = connector, request
        self._open: dict[str, _Watch] = {}
        self._named = ANY  # the replica that the watch on any of them has found
        self._start(ANY)

    def note(self, seen: Seen) -> None:
        """Follows what a sign of life says of the replicas: each is watched once."""
        response = seen.response
        if not response.replica:
            return
        if seen.watch == ANY:
            self._named = response.replica
            self._stop(self._named)
        elif seen.watch != response.replica:  # it is gone, and the proxy has sent us elsewhere
            self._stop(seen.watch)
        self._prune()
        for replica in response.replicas:
            if replica not in (self._named, *self._open):
                self._start(replica)

    def _start(self, replica: str) -> None:
        self._open[replica] = _Watch(self, replica)

    def _stop(self, replica: str) -> None:
        if (watch := self._open.pop(replica, None)) is not None:
            watch.stop()

    def _prune(self) -> None:
        for replica in [replica for replica, watch in self._open.items() if watch.over]:
            del self._open[replica]

    def close(self) -> None:
        """Ends all calls; their threads end by themselves."""
        for replica in list(self._open):
            self._stop(replica)

    # -- what the threads use -----------------------------------------------------------------------------------

    def call(self, channel: grpc.Channel, replica: str) -> Any:
        metadata = self._connector.metadata()
        if replica != ANY:
            metadata = (*metadata, (_REPLICA, replica))
        return view_pb2_grpc.ViewServiceStub(channel).WatchScans(self._request, metadata=metadata)

    def channel(self) -> grpc.Channel:
        return self._connector.channel(_OPTIONS)


class _Watch:
    """One replica. That of a name ends with its connection; the one on any of them comes back until it is stopped."""

    def __init__(self, watches: Watches, replica: str) -> None:
        self._watches, self._replica = watches, replica
        self._stopped = threading.Event()
        self._call: Any = None
        self._thread = threading.Thread(target=self._run, name=f"watch-{replica or 'any'}", daemon=True)
        self._thread.start()

    @property
    def over(self) -> bool:
        return not self._thread.is_alive()

    def stop(self) -> None:
        self._stopped.set()
        if (call := self._call) is not None:
            call.cancel()

    def _run(self) -> None:
        while not self._stopped.is_set():
            trouble = self._once()
            if self._stopped.is_set():
                return
            if trouble is not None and self._replica == ANY:
                self._put([trouble])
                if trouble.final:
                    return
            if self._replica != ANY:
                return
            self._stopped.wait(_RETRY_S)

    def _once(self) -> Trouble | None:
        try:
            with self._watches.channel() as channel:
                self._call = self._watches.call(channel, self._replica)
                self._put(Seen(self._replica, response) for response in self._call)
        except grpc.RpcError as error:
            code, detail = (error.code(), error.details()) if isinstance(error, grpc.Call) else (None, str(error))
            return Trouble(f"{code.name.lower() if code else 'failed'}: {detail}", code in _FINAL)
        return None

    def _put(self, items: Iterable[Any]) -> None:
        for item in items:
            while not self._stopped.is_set():
                with suppress(queue.Full):
                    self._watches.items.put(item, timeout=_PUT_S)
                    break
            else:
                return
