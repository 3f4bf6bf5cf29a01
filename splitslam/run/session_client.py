"""What a finished session holds, fetched from the map service."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import grpc
import numpy as np
from numpy.typing import NDArray

from splitslam import dense_cloud, se3
from splitslam.errors import DataError
from splitslam.run.processes import RunFailedError
from splitslam.run.tables import KeyframeRow
from splitslam.security.client import Connector
from splitslam.security.settings import ClientTls
from splitslam.tum import Trajectory
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc
from splitslam.wire import types_pb2 as types

_CALL_S = 30.0
_STREAM_S = 600.0
_LONG_S = 6 * 3600.0


class NoSessionError(RunFailedError):
    """The server knows no session of that name."""


class SessionClient:
    """SessionService of one server, for one session. Every call raises RunFailedError when it fails."""

    def __init__(self, stub: Any, session_id: str, metadata: tuple[tuple[str, str], ...] = ()) -> None:
        """metadata: what every call carries."""
        self._stub, self._id, self._metadata = stub, session_id, metadata
        self.keyframes: list[KeyframeRow] = []

    def info(self) -> tuple[pb.SessionInfo, dict[str, Any]]:
        """The session and its statistics."""
        with _named("Get"):
            request = pb.GetRequest(session_id=self._id)
            session = self._stub.Get(request, timeout=_CALL_S, metadata=self._metadata).session
        return session, json.loads(session.statistics_json or "{}")

    def stored_poses(self) -> list[types.StampedPose]:
        """Every mapped frame with its final optimised pose T_map_lidar, in order of time."""
        with _named("Trajectory"):
            request = pb.TrajectoryRequest(session_id=self._id)
            pages = self._stub.Trajectory(request, timeout=_STREAM_S, metadata=self._metadata)
            poses = [pose for page in pages for pose in page.poses]
        return sorted(poses, key=lambda pose: pose.stamp_ns)

    def trajectory(self) -> Trajectory:
        """Final optimised poses T_map_lidar in order of time."""
        return as_trajectory(self.stored_poses())

    def map_pieces(self) -> Iterator[bytes]:
        """Points of one keyframe after the other; the keyframes themselves gather in `keyframes`."""
        with _named("StreamMap"):
            request = pb.StreamMapRequest(session_id=self._id, dense=True)
            for message in self._stub.StreamMap(request, timeout=_STREAM_S, metadata=self._metadata):
                points = points_of(message)
                self.keyframes.append(KeyframeRow(message.keyframe, len(points), _numbers(message.pose_map_lidar)))
                yield points.tobytes()

    def map_messages(self, voxel_m: float, *, dense: bool = False) -> Iterator[pb.StreamMapResponse]:
        """Every keyframe with its points; with voxel_m > 0 one point a voxel. A large map may take its time.

        dense: as whole scans where there are any, and then not thinned.
        """
        with _named("StreamMap"):
            request = pb.StreamMapRequest(session_id=self._id, voxel_m=0.0 if dense else voxel_m, dense=dense)
            yield from self._stub.StreamMap(request, timeout=_LONG_S, metadata=self._metadata)

    def graph_messages(self) -> Iterator[pb.PoseGraphResponse]:
        """The factor graph in parts."""
        with _named("PoseGraph"):
            request = pb.PoseGraphRequest(session_id=self._id)
            yield from self._stub.PoseGraph(request, timeout=_STREAM_S, metadata=self._metadata)


def points_of(message: pb.StreamMapResponse) -> NDArray[np.float32]:
    """(N, 4) x y z, m, in `map`, and intensity. Raises RunFailedError for a whole scan that cannot be read."""
    if not message.dense_cloud:
        return np.frombuffer(message.points, "<f4").reshape(-1, 4)
    try:
        return dense_cloud.in_map(message.dense_cloud, square(message.pose_map_lidar))
    except DataError as error:
        raise RunFailedError(f"map service: keyframe {message.keyframe}: {error}") from None


def square(pose: types.Transform) -> NDArray[np.float64]:
    """(4, 4)."""
    values = np.array(_numbers(pose))
    return se3.from_quat(values[:3], values[3:])


def as_trajectory(poses: list[types.StampedPose]) -> Trajectory:
    """Messages in order of time -> trajectory."""
    values = np.array([_numbers(pose.pose) for pose in poses]).reshape(-1, 7)
    stamps_ns = np.array([pose.stamp_ns for pose in poses], np.int64)
    return Trajectory(stamps_ns, values[:, :3], values[:, 3:])


@contextmanager
def session_client(address: str, session_id: str, tls: ClientTls | None = None) -> Iterator[SessionClient]:
    """Connected for as long as the block runs."""
    connector = Connector(address, tls or ClientTls())
    with connector.channel([("grpc.max_receive_message_length", -1)]) as channel:
        yield SessionClient(rpc.SessionServiceStub(channel), session_id, connector.metadata())


@contextmanager
def _named(call: str) -> Iterator[None]:
    try:
        yield
    except grpc.RpcError as error:
        detail = error.details() if isinstance(error, grpc.Call) else str(error)
        gone = isinstance(error, grpc.Call) and error.code() == grpc.StatusCode.NOT_FOUND
        failed = NoSessionError if gone else RunFailedError
        raise failed(f"map service: {call}: {detail}") from None


def _numbers(pose: types.Transform) -> tuple[float, float, float, float, float, float, float]:
    return pose.tx_m, pose.ty_m, pose.tz_m, pose.qx, pose.qy, pose.qz, pose.qw
