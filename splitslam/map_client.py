"""A client of the map service's PoseService that goes on after whatever breaks: docs/api.md."""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Callable, Iterator
from typing import Any, Self, TypeVar
from urllib.parse import quote

import grpc
import numpy as np

from splitslam import se3
from splitslam.logs import fields
from splitslam.security.client import Connector
from splitslam.security.settings import ClientTls
from splitslam.wire import pose_pb2 as pb
from splitslam.wire import pose_pb2_grpc as rpc
from splitslam.wire import types_pb2 as types_pb

_CALL_S = 10.0
_FIRST_WAIT_S, _WAIT_CAP_S = 0.1, 2.0
_OPTIONS = [
    ("grpc.max_receive_message_length", -1),
    ("grpc.keepalive_time_ms", 5000),  # a service that is frozen does not end its connections
    ("grpc.keepalive_timeout_ms", 2000),
    ("grpc.http2.max_pings_without_data", 0),
]
# Errors of the call, which the same call would meet again; all others are of the way there.
_FINAL = {
    grpc.StatusCode.INVALID_ARGUMENT,
    grpc.StatusCode.NOT_FOUND,
    grpc.StatusCode.OUT_OF_RANGE,
    grpc.StatusCode.PERMISSION_DENIED,
    grpc.StatusCode.UNAUTHENTICATED,
    grpc.StatusCode.UNIMPLEMENTED,
    grpc.StatusCode.DATA_LOSS,
}

R = TypeVar("R")
_log = logging.getLogger(__name__)


class MapClient:
    """One server, or the proxy before several. Calls raise grpc.RpcError for what trying again does not mend."""

    def __init__(self, server: str, tls: ClientTls | None = None) -> None:
        """Raises InputError for certificates that cannot be used."""
        self._connector = Connector(server, tls or ClientTls())
        self._channel = self._connector.channel(_OPTIONS)
        self._stub = rpc.PoseServiceStub(self._channel)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends every call."""
        self._channel.close()

    def watch_poses(
        self, sessions: pb.SessionSelection | None = None, *, from_start: bool = False
    ) -> Iterator[pb.WatchPosesResponse]:
        """Scans as they are answered, each once, and what corrections have moved; until all named sessions end."""
        request = pb.WatchPosesRequest(sessions=sessions, from_start=from_start)
        for response in self._resumed(self._stub.WatchPoses, request):
            if response.cursor:
                request.cursor = response.cursor
                request.after_seq.clear()
            for pose in response.poses:
                request.after_seq[pose.session_id] = pose.seq
            yield response

    def events(
        self, sessions: pb.SessionSelection | None = None, *, cursor: str = "", from_start: bool = False
    ) -> Iterator[pb.EventsResponse]:
        """What happens to sessions. cursor: of the last message that was dealt with, to go on after it."""
        request = pb.EventsRequest(sessions=sessions, cursor=cursor, from_start=from_start)
        for response in self._resumed(self._stub.Events, request):
            request.cursor = response.cursor
            yield response

    def pose_at(self, session_id: str, stamp_ns: int, map_version: int = 0) -> pb.PoseAtResponse:
        """Where the robot was, by the map of now (0) or as it was in that version."""
        request = pb.PoseAtRequest(session_id=session_id, stamp_ns=stamp_ns, map_version=map_version)
        return self._stub.PoseAt(request, timeout=_CALL_S, metadata=self._metadata([session_id]))

    def local_map(self, session_id: str, radius_m: float, **options: Any) -> Iterator[tuple[int, np.ndarray]]:
        """(keyframe, points (N, 4) float32: x y z m in `map`, intensity), nearest first. options: LocalMapRequest's."""
        request = pb.LocalMapRequest(session_id=session_id, radius_m=radius_m, **options)
        for piece in self._stub.LocalMap(request, metadata=self._metadata([session_id])):
            yield piece.keyframe, np.frombuffer(piece.points, "<f4").reshape(-1, 4)

    def _resumed(self, call: Callable[..., Iterator[R]], request: Any) -> Iterator[R]:
        """The messages of a call that is made again, with the request as it is by then, when it breaks."""
        wait_s = _FIRST_WAIT_S
        while True:
            try:
                for response in call(request, metadata=self._metadata(request.sessions.session_ids)):
                    wait_s = _FIRST_WAIT_S
                    yield response
                return
            except grpc.RpcError as error:
                code: Any = error.code() if isinstance(error, grpc.Call) else None
                if code in _FINAL or code is None:
                    raise
                _log.info("call made again", extra=fields(reason=code.name.lower()))
            time.sleep(random.uniform(0.0, wait_s))
            wait_s = min(2 * wait_s, _WAIT_CAP_S)

    def _metadata(self, session_ids: Any) -> tuple[tuple[str, str], ...]:
        """A call about one session goes where that is most likely served, if the proxy can choose."""
        metadata = self._connector.metadata()
        if len(session_ids) != 1:
            return metadata
        robot_id, _, run_id = session_ids[0].partition("/")
        return (*metadata, ("splitslam-route-key", f"{quote(robot_id, safe='')}/{run_id}#0"))


def matrix(pose: types_pb.Transform) -> np.ndarray:
    """(4, 4) float64."""
    return se3.from_quat(np.array([pose.tx_m, pose.ty_m, pose.tz_m]), np.array([pose.qx, pose.qy, pose.qz, pose.qw]))
