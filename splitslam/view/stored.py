"""A session as a map service has stored it, run or running: its map and its way, corrected."""

from __future__ import annotations

import grpc

from splitslam.run.processes import RunFailedError
from splitslam.run.session_client import SessionClient
from splitslam.security.client import Connector
from splitslam.view.fetcher import OPTIONS, stored_keyframes
from splitslam.view.scene import Scene
from splitslam.view.session_view import SessionView
from splitslam.wire import session_pb2_grpc as rpc


def show_session(session_id: str, connector: Connector, scene: Scene) -> None:
    """Raises RunFailedError when the service does not give it."""
    session = SessionView(session_id, scene.robot(session_id.partition("/")[0]))
    with connector.channel(OPTIONS) as channel:
        stub, metadata = rpc.SessionServiceStub(channel), connector.metadata()
        session.take_way(SessionClient(stub, session_id, metadata).trajectory())
        try:
            for keyframe in stored_keyframes(stub, session_id, 0, metadata):
                session.take_keyframe(keyframe)
        except grpc.RpcError as error:
            detail = error.details() if isinstance(error, grpc.Call) else str(error)
            raise RunFailedError(f"map service: StreamMap: {detail}") from None
    session.fetched()
