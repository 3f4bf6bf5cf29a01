"""The port: plain, or TLS with the certificates as they are on disk at each handshake."""

from __future__ import annotations

import logging

import grpc

from map_service.callers import Callers
from map_service.metrics import ServiceMetrics
from map_service.revoked import RevokedList
from splitslam.errors import InputError
from splitslam.logs import fields
from splitslam.security.certificates import CertificateFiles, Certificates
from splitslam.security.loopback import is_loopback
from splitslam.security.settings import ServerTls
from splitslam.security.tokens import TokenTable

_log = logging.getLogger(__name__)


class Door:
    """Opens the port, and knows how to tell who comes in (`callers`)."""

    def __init__(self, tls: ServerTls, metrics: ServiceMetrics) -> None:
        """Raises InputError for files that cannot be used."""
        self._tls, self._metrics = tls, metrics
        self._files: CertificateFiles | None = None
        self._given: Certificates | None = None
        if tls.cert is None or tls.key is None or tls.ca is None:
            self.callers = Callers(None)
            return
        self._files = CertificateFiles(tls.cert, tls.key, tls.ca)
        own = self._files.current().identity
        if own is None or own.role != "service":
            raise InputError(f"tls.cert: {tls.cert}: expected a service's certificate, found that of {own}")
        tokens = TokenTable(tls.tokens) if tls.tokens is not None else None
        revoked = RevokedList(tls.revoked) if tls.revoked is not None else None
        self.callers = Callers(own.fleet, tokens, revoked)
        metrics.certificate_from(lambda: self._certificates().expires_s)

    def _certificates(self) -> Certificates:
        assert self._files is not None
        return self._files.current()

    def open(self, server: grpc.aio.Server, listen: str) -> int:
        """Returns the port. Raises RuntimeError when it cannot be bound."""
        if self._files is None:
            if not is_loopback(listen):
                _log.warning("INSECURE: everybody is believed, and can be read on the way", extra=fields(listen=listen))
            return server.add_insecure_port(listen)
        self._given = self._files.current()
        credentials = grpc.dynamic_ssl_server_credentials(
            _configuration(self._given),
            self._at_handshake,  # pyright: ignore[reportArgumentType] (its stubs lack the None that is documented)
            self._tls.clients == "certificate",
        )
        return server.add_secure_port(listen, credentials)

    def _at_handshake(self) -> grpc.ServerCertificateConfiguration | None:
        """Called by gRPC at the beginning of each; None: as it was."""
        self._metrics.handshakes.inc()
        certificates = self._certificates()
        if certificates is self._given:
            return None
        self._given = certificates
        return _configuration(certificates)


def _configuration(certificates: Certificates) -> grpc.ServerCertificateConfiguration:
    assert certificates.key is not None
    assert certificates.cert is not None
    return grpc.ssl_server_certificate_configuration([(certificates.key, certificates.cert)], certificates.ca)
