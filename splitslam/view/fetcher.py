"""What the service has stored of sessions, fetched by one thread while others go on: keyframes with points, the way."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import grpc

from splitslam.run.processes import RunFailedError
from splitslam.run.session_client import SessionClient
from splitslam.security.client import Connector
from splitslam.tum import Trajectory
from splitslam.view.decoding import points_and_intensity, transform
from splitslam.view.history import ShownKeyframe, in_own_frame
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc

_STREAM_S = 600.0
OPTIONS = (("grpc.max_receive_message_length", -1),)


@dataclass(frozen=True, slots=True)
class Wanted:
    """Of one session: keyframes from `first` on; way: the trajectory, too."""

    session_id: str
    first: int = 0
    way: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FetchedKeyframe:
    session_id: str
    keyframe: ShownKeyframe


@dataclass(frozen=True, slots=True, eq=False)
class FetchedWay:
    session_id: str
    trajectory: Trajectory


@dataclass(frozen=True, slots=True)
class FetchDone:
    """All that was wanted has come; or not, and why."""

    session_id: str
    problem: str = ""


def stored_keyframes(stub: Any, session_id: str, first: int, metadata: Any) -> Iterator[ShownKeyframe]:
    """In order. Raises grpc.RpcError, or ValueError for points that are none."""
    request = pb.StreamMapRequest(session_id=session_id, first_keyframe=first)
    for piece in stub.StreamMap(request, timeout=_STREAM_S, metadata=metadata):
        T = transform(piece.pose_map_lidar)
        yield ShownKeyframe(piece.keyframe, T, in_own_frame(points_and_intensity(piece.points)[:, :3], T))


class Fetcher:
    """Answers come by `put`, one job after the other."""

    def __init__(self, connector: Connector, put: Callable[[Any], None]) -> None:
        self._connector, self._put = connector, put
        self._jobs: queue.SimpleQueue[Wanted] = queue.SimpleQueue()
        threading.Thread(target=self._run, name="fetcher", daemon=True).start()

    def fetch(self, wanted: Wanted) -> None:
        self._jobs.put(wanted)

    def _run(self) -> None:
        while True:
            wanted = self._jobs.get()
            try:
                self._one(wanted)
            except (grpc.RpcError, RunFailedError, ValueError) as error:
                detail = error.details() if isinstance(error, grpc.Call) else str(error)
                self._put(FetchDone(wanted.session_id, str(detail)))
            else:
                self._put(FetchDone(wanted.session_id))

    def _one(self, wanted: Wanted) -> None:
        with self._connector.channel(OPTIONS) as channel:
            stub, metadata = rpc.SessionServiceStub(channel), self._connector.metadata()
            if wanted.way:
                way = SessionClient(stub, wanted.session_id, metadata).trajectory()
                self._put(FetchedWay(wanted.session_id, way))
            for keyframe in stored_keyframes(stub, wanted.session_id, wanted.first, metadata):
                self._put(FetchedKeyframe(wanted.session_id, keyframe))
