"""A session out of a running map service."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from splitslam import config
from splitslam.errors import InputError
from splitslam.maps import AntennaFix, Between, MapGraph, MapPiece
from splitslam.run.session_client import NoSessionError, SessionClient, points_of, session_client, square
from splitslam.security.settings import ClientTls
from splitslam.thinning import thinned
from splitslam.tum import Trajectory
from splitslam.wire import session_pb2 as pb


class ServerSource:
    """One session of a server."""

    def __init__(self, client: SessionClient, name: str, dense: bool = True) -> None:
        """dense: whole scans of keyframes where there are any."""
        self._client, self._name, self._dense = client, name, dense
        info, _ = client.info()
        self._keyframes = info.keyframes

    @property
    def name(self) -> str:
        return self._name

    @property
    def pieces_expected(self) -> int | None:
        return self._keyframes

    @property
    def has_keyframes(self) -> bool:
        return True

    def pieces(self, voxel_m: float) -> Iterator[MapPiece]:
        """As MapSource."""
        pieces = map(_piece, self._client.map_messages(voxel_m, dense=self._dense))
        return thinned(pieces, voxel_m) if self._dense else pieces

    def trajectory(self) -> Trajectory:
        """As MapSource."""
        return self._client.trajectory()

    def graph(self) -> MapGraph | None:
        """As MapSource."""
        return graph_from_wire(list(self._client.graph_messages()))


@contextmanager
def server_source(session_id: str, address: str, tls: Path | None, dense: bool = True) -> Iterator[ServerSource]:
    """tls: YAML like the agent's section of that name; the environment (SPLITSLAM_TLS__CA, ...) overrides it.

    Raises InputError for an address or certificates that cannot be used, or a session that the server does not know.
    """
    with session_client(address, session_id, config.load(ClientTls, tls, "SPLITSLAM_TLS__")) as client:
        try:
            source = ServerSource(client, session_id, dense)
        except NoSessionError:
            raise InputError(f"{address}: no session {session_id!r}") from None
        yield source


def graph_from_wire(messages: list[pb.PoseGraphResponse]) -> MapGraph:
    """The parts of a graph as one; the first message says where `enu` is."""
    keyframes = [k for message in messages for k in message.keyframes]
    first = messages[0]
    origin = first.origin
    return MapGraph(
        T_map_lidar=np.array([square(k.pose_map_lidar) for k in keyframes]).reshape(-1, 4, 4),
        stamps_ns=np.array([k.stamp_ns for k in keyframes], np.int64),
        betweens=[_between(edge) for message in messages for edge in message.edges],
        fixes=[_fix(fix) for message in messages for fix in message.fixes],
        T_enu_map={d.datum: square(d.pose_enu_map) for d in first.data},
        origin=(origin.latitude_deg, origin.longitude_deg, origin.altitude_m) if first.HasField("origin") else None,
        others=dict(first.others),
    )


def _between(edge: pb.GraphEdge) -> Between:
    covariance = np.reshape(edge.covariance, (6, 6))
    return Between(edge.kind, edge.older, edge.newer, square(edge.pose_older_newer), covariance, edge.robust)


def _fix(fix: pb.GraphFix) -> AntennaFix:
    antenna, enu_m, sigmas_m = (np.array(values) for values in (fix.antenna_keyframe_m, fix.enu_m, fix.sigmas_m))
    return AntennaFix(fix.keyframe, antenna, enu_m, sigmas_m, fix.datum)


def _piece(message: pb.StreamMapResponse) -> MapPiece:
    T_map_lidar, dense = square(message.pose_map_lidar), bool(message.dense_cloud)
    return MapPiece(message.keyframe, message.stamp_ns, T_map_lidar, points_of(message), dense)
