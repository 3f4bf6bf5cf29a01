"""Does a running service take robots? Its own health check, asked as a proxy asks: for containers and probes."""

from __future__ import annotations

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from map_service.config import ServiceConfig
from splitslam.errors import InputError

_ASKED = "splitslam.v1.EdgeService"
_EVERYWHERE = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}  # what a server listens on, and where it can be reached


def problem_with(config: ServiceConfig, server: str | None = None, timeout_s: float = 2.0) -> str | None:
    """Why the service at `server` takes no robots now, or None. server: None: the one with this configuration.

    Raises InputError when that one's configuration leaves no way to ask it.
    """
    if server is None and config.health_socket is None and config.tls.cert is not None:
        raise InputError("health_socket: expected a Unix socket's path: with tls nobody answers elsewhere")
    address = server or (f"unix:{config.health_socket.absolute()}" if config.health_socket else _own(config.listen))
    try:
        with grpc.insecure_channel(address) as channel:
            request = health_pb2.HealthCheckRequest(service=_ASKED)
            check = health_pb2_grpc.HealthStub(channel).Check  # pyright: ignore[reportAttributeAccessIssue] (no stubs)
            answer = check(request, timeout=timeout_s)
    except grpc.RpcError as error:
        code = getattr(error, "code", lambda: grpc.StatusCode.UNKNOWN)()
        return f"map service at {address}: no answer within {timeout_s:g} s ({code.name})"
    if answer.status != health_pb2.HealthCheckResponse.SERVING:
        return f"map service at {address}: {health_pb2.HealthCheckResponse.ServingStatus.Name(answer.status)}"
    return None


def _own(listen: str) -> str:
    host, _, port = listen.rpartition(":")
    return f"{_EVERYWHERE.get(host, host)}:{port}"
