"""Whether a map service says that it serves: grpc.health.v1, asked without its package, which robots do not have."""

from __future__ import annotations

import math
import time

import grpc

from splitslam.diagnose.checks import Check, Verdict
from splitslam.security.client import Connector

_ASK_S = 3.0
_SOON_DAYS = 14.0
_SERVING = b"\x08\x01"  # HealthCheckResponse{status: SERVING}


def service_health(name: str, address: str, connector: Connector) -> Check:
    """One question over a connection like those of the uplink."""
    with connector.channel() as channel:
        ask = channel.unary_unary(
            "/grpc.health.v1.Health/Check", request_serializer=bytes, response_deserializer=lambda raw: raw
        )
        try:
            answer = ask(b"", timeout=_ASK_S, metadata=connector.metadata())
        except grpc.RpcError as error:
            code = error.code().name if isinstance(error, grpc.Call) else "no answer"
            return Check(name, Verdict.FAIL, f"{address}: {code}{connector.trouble()}; expected SERVING")
    if answer == _SERVING:
        return Check(name, Verdict.OK, f"{address}: SERVING")
    return Check(name, Verdict.FAIL, f"{address}: it says that it does not serve")


def certificate(connector: Connector) -> list[Check]:
    """How long the certificates of this side are good for; nothing to say without any."""
    days = (connector.expires_s - time.time()) / 86400
    if math.isnan(days):
        return []
    text = f"good for {days:.0f} days"
    if days < _SOON_DAYS:
        return [Check("certificate", Verdict.FAIL if days < 0 else Verdict.WARN, f"{text}: `splitslam certs`")]
    return [Check("certificate", Verdict.OK, text)]
