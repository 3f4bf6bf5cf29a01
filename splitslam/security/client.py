"""Connections to a map service, with the certificates and the token as they are on disk at the time."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import grpc

from splitslam.errors import InputError
from splitslam.logs import fields
from splitslam.security.settings import ClientTls
from splitslam.security.tokens import SCHEME

_log = logging.getLogger(__name__)
Options = Sequence[tuple[str, Any]]


class Connector:
    """Opens channels to `server` as `tls` says; plain ones when it says nothing."""

    def __init__(self, server: str, tls: ClientTls) -> None:
        """Raises InputError for files that cannot be used, or a server that must not be talked to in the clear."""
        try:
            tls.check(server)
        except ValueError as error:
            raise InputError(str(error)) from None
        self._server, self._tls = server, tls
        self._token = ""
        self._files = None
        if tls.ca is not None:
            from splitslam.security.certificates import CertificateFiles  # not needed on loopback, and not light

            self._files = CertificateFiles(tls.cert, tls.key, tls.ca)
        self.metadata()

    def channel(self, options: Options = ()) -> grpc.Channel:
        """A new one each time: a rotated certificate is used from the next connection on."""
        if self._files is None:
            return grpc.insecure_channel(self._server, options=options)
        files = self._files.current()
        credentials = grpc.ssl_channel_credentials(files.ca, files.key, files.cert)
        if self._tls.server_name is not None:
            options = (*options, ("grpc.ssl_target_name_override", self._tls.server_name))
        return grpc.secure_channel(self._server, credentials, options=options)

    def metadata(self) -> tuple[tuple[str, str], ...]:
        """What every call carries: the token, if there is one. Raises InputError when it never could be read."""
        if self._tls.token is not None:
            try:
                self._token = _read_token(self._tls.token)
            except InputError as error:
                if not self._token:
                    raise
                _log.warning("token not read: the one of before is used", extra=fields(detail=str(error)))
        return (("authorization", f"{SCHEME}{self._token}"),) if self._token else ()

    def trouble(self, turned_away: bool = False) -> str:
        """What may be wrong on this side when a connection fails: TLS 1.3 does not tell a client why it was refused.

        turned_away: the connection was taken, and closed before a word was said.
        """
        if turned_away and self._files is None:
            return " (a service with TLS turns those away that have no `tls`, as here)"
        expired_s = self.expires_s
        if expired_s < time.time():
            return f" (the certificate expired on {datetime.fromtimestamp(expired_s, UTC):%Y-%m-%d %H:%M} UTC)"
        return ""

    @property
    def expires_s(self) -> float:
        """Unix time of the first certificate to expire, s; NaN without any."""
        return float("nan") if self._files is None else self._files.current().expires_s


def _read_token(path: Path) -> str:
    try:
        token = path.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"tls.token: {path}: cannot read: {error}") from None
    if not token.isascii() or not token.isprintable() or not token:
        raise InputError(f"tls.token: {path}: expected one token and nothing else")
    return token
