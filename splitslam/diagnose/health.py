"""Whether a map service says that it serves: grpc.health.v1, asked without its package, which robots do not have."""

from __future__ import annotations

import grpc

from splitslam.diagnose.checks import Check, Verdict

_ASK_S = 3.0
_SERVING = b"\x08\x01"  # HealthCheckResponse{status: SERVING}


def service_health(name: str, address: str) -> Check:
    """One question to host:port, in the clear: a service behind TLS does not answer it."""
    with grpc.insecure_channel(address) as channel:
        ask = channel.unary_unary(
            "/grpc.health.v1.Health/Check", request_serializer=bytes, response_deserializer=lambda raw: raw
        )
        try:
            answer = ask(b"", timeout=_ASK_S)
        except grpc.RpcError as error:
            code = error.code().name if isinstance(error, grpc.Call) else "no answer"
            return Check(name, Verdict.WARN, f"{address}: {code}; expected SERVING (TLS is not spoken here)")
    if answer == _SERVING:
        return Check(name, Verdict.OK, f"{address}: SERVING")
    return Check(name, Verdict.FAIL, f"{address}: it says that it does not serve")
