"""Who calls: by the connection's certificate, by what the proxy says of its own connection, or by a token."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from cryptography import x509
from cryptography.hazmat.primitives import hashes

from map_service.revoked import RevokedList
from splitslam.security.identity import Identity
from splitslam.security.tokens import SCHEME, TokenTable

XFCC = "x-forwarded-client-cert"
CLAIM = "splitslam-claimed-client-cert"  # what a client itself sent as XFCC: deploy/envoy/envoy-tls.yaml
Reason = Literal[
    "no_identity",
    "bad_certificate",
    "other_fleet",
    "revoked",
    "forged_xfcc",
    "bad_xfcc",
    "bad_token",
    "identity_conflict",
    "not_a_robot",
    "not_an_operator",
    "other_robot",
    "other_site",
    "route_key",
    "streams",
    "opens",
]
_HEX_64 = re.compile(r"[0-9a-f]{64}")
# Envoy's keys; a quoted value may hold anything but a bare quote
_PAIR = re.compile(r'(By|Hash|Cert|Chain|Subject|URI|DNS)=("(?:[^"\\]|\\.)*"|[^",;]*)')


class DeniedError(Exception):
    """The caller is not who it must be; `reason` is its counter's label."""

    def __init__(self, reason: Reason, detail: str) -> None:
        super().__init__(detail)
        self.reason, self.detail = reason, detail


class CallContext(Protocol):
    """What is asked of grpc.aio.ServicerContext."""

    def auth_context(self) -> Mapping[str, Iterable[bytes]]: ...

    def invocation_metadata(self) -> Any: ...  # of (key, value), or None


@dataclass(frozen=True, slots=True)
class Caller:
    """identity: None: anybody, where nobody is asked (no TLS). fingerprint: of its certificate, "" with a token."""

    identity: Identity | None = None
    fingerprint: str = ""


ANYBODY = Caller()


class Callers:
    """Nobody is asked without TLS: then the address that is listened on is all the protection there is."""

    def __init__(self, fleet: str | None, tokens: TokenTable | None = None, revoked: RevokedList | None = None) -> None:
        """fleet: of the service's own certificate; None: without TLS."""
        self._fleet, self._tokens, self._revoked = fleet, tokens, revoked

    def identify(self, context: CallContext) -> Caller:
        """Raises DeniedError for who cannot be believed."""
        if self._fleet is None:
            return ANYBODY
        metadata = [(key, value) for key, value in context.invocation_metadata() or () if isinstance(value, str)]
        by_certificate = self._by_certificate(context, metadata)
        by_token = self._by_token(metadata)
        if by_certificate is None and by_token is None:
            raise DeniedError("no_identity", "expected a certificate of the fleet or a token, found neither")
        if by_certificate is not None and by_token is not None and by_certificate.identity != by_token.identity:
            raise DeniedError("identity_conflict", "the certificate and the token name different members of the fleet")
        caller = by_certificate or by_token
        assert caller is not None
        self.check_revoked(caller)
        return caller

    def check_revoked(self, caller: Caller) -> None:
        """Raises DeniedError; also asked of callers whose stream is open."""
        if self._revoked is not None and caller.fingerprint and self._revoked.holds(caller.fingerprint):
            raise DeniedError("revoked", "the certificate has been revoked")

    def _by_certificate(self, context: CallContext, metadata: list[tuple[str, str]]) -> Caller | None:
        """Of the connection, or of the connection to the proxy."""
        connection = _connection(context.auth_context())
        forwarded = [value for key, value in metadata if key == XFCC]
        claimed = any(key == CLAIM for key, _ in metadata)
        if connection is None:
            if forwarded or claimed:
                raise DeniedError("forged_xfcc", f"{XFCC}: expected from the proxy only")
            return None
        self._check_fleet(connection)
        assert connection.identity is not None
        if connection.identity.role != "envoy":
            if forwarded or claimed:
                raise DeniedError("forged_xfcc", f"{XFCC}: expected from the proxy only")
            return connection
        if claimed:  # the proxy has replaced it, but who sends it is up to something
            raise DeniedError("forged_xfcc", f"{XFCC}: a client may not send it")
        if not forwarded:
            return None
        caller = forwarded_caller(forwarded)
        self._check_fleet(caller)
        return caller

    def _check_fleet(self, caller: Caller) -> None:
        assert caller.identity is not None
        if caller.identity.fleet != self._fleet:
            raise DeniedError("other_fleet", f"{caller.identity}: expected one of fleet {self._fleet}")

    def _by_token(self, metadata: list[tuple[str, str]]) -> Caller | None:
        given = [value for key, value in metadata if key == "authorization"]
        if not given:
            return None
        owner = None
        if len(given) == 1 and given[0].startswith(SCHEME) and self._tokens is not None:
            owner = self._tokens.owner(given[0].removeprefix(SCHEME))
        if owner is None or owner.fleet != self._fleet:
            raise DeniedError("bad_token", "the token is nobody's")
        return Caller(owner)


def _connection(auth: Mapping[str, Iterable[bytes]]) -> Caller | None:
    """Whom the certificate of the connection names; the handshake has verified it. None: there is none."""
    pem = list(auth.get("x509_pem_cert", ()))
    if not pem:
        return None
    names = [name.decode() for name in auth.get("x509_subject_alternative_name", ()) if b"://" in name]
    return Caller(_only_identity(names), x509.load_pem_x509_certificate(pem[0]).fingerprint(hashes.SHA256()).hex())


def forwarded_caller(values: Sequence[str]) -> Caller:
    """The one element of Envoy's header under SANITIZE_SET. Raises DeniedError for anything else."""
    pairs = _pairs(values[0]) if len(values) == 1 else []
    uris = [value for key, value in pairs if key == "URI"]
    prints = [value for key, value in pairs if key == "Hash"]
    if not uris or len(prints) != 1 or not _HEX_64.fullmatch(prints[0]):
        raise DeniedError("bad_xfcc", f"{XFCC}: expected one element with Hash and URI")
    return Caller(_only_identity(uris), prints[0])


def _pairs(element: str) -> list[tuple[str, str]]:
    """`Key=value;Key="value"` -> pairs; empty for what does not read so to its end."""
    pairs, at = [], 0
    while match := _PAIR.match(element, at):
        pairs.append((match[1], match[2].strip('"')))
        at = match.end()
        if at == len(element):
            return pairs
        if element[at] != ";":
            break
        at += 1
    return []


def _only_identity(uris: list[str]) -> Identity:
    if len(uris) != 1:
        raise DeniedError("bad_certificate", f"the certificate has {len(uris)} URIs, expected one")
    try:
        return Identity.parse(uris[0])
    except ValueError as error:
        raise DeniedError("bad_certificate", str(error)) from None
