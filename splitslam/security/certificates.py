"""A certificate, its key and the authority that signs the others', from files that may change at any time."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key

from splitslam.errors import InputError
from splitslam.logs import fields
from splitslam.security.identity import Identity
from splitslam.watched_files import WatchedFiles

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Certificates:
    """PEM of what belongs together; without `cert` and `key` only the authority is known.

    identity: whom the certificate names. expires_s: Unix time of the first of all of them to expire, s.
    """

    cert: bytes | None
    key: bytes | None
    ca: bytes
    identity: Identity | None
    expires_s: float


def identities_of(certificate: x509.Certificate) -> list[str]:
    """URIs of its subject alternative name."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return names.get_values_for_type(x509.UniformResourceIdentifier)


def identity_of(certificate: x509.Certificate) -> Identity:
    """Raises ValueError when it does not name exactly one member of a fleet."""
    uris = identities_of(certificate)
    if len(uris) != 1:
        raise ValueError(f"the certificate has {len(uris)} URIs, expected one")
    return Identity.parse(uris[0])


def read_certificates(cert: Path | None, key: Path | None, ca: Path) -> Certificates:
    """Raises InputError for files that cannot be read, are no PEM, or do not belong together."""
    ca_pem = _read(ca)
    chain = _parsed(ca, ca_pem)
    if cert is None or key is None:
        return Certificates(None, None, ca_pem, None, _first_expiry_s(chain))
    cert_pem, key_pem = _read(cert), _read(key)
    own = _parsed(cert, cert_pem)
    try:
        public = load_pem_private_key(key_pem, None).public_key()
    except (ValueError, TypeError) as error:
        raise InputError(f"{key}: expected a private key in PEM without a password") from error
    if _der(public) != _der(own[0].public_key()):
        raise InputError(f"{key}: expected the key of {cert}")
    try:
        identity = identity_of(own[0])
    except ValueError as error:
        raise InputError(f"{cert}: {error}") from error
    return Certificates(cert_pem, key_pem, ca_pem, identity, _first_expiry_s([*own, *chain]))


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error


def _parsed(path: Path, pem: bytes) -> list[x509.Certificate]:
    try:
        return x509.load_pem_x509_certificates(pem)
    except ValueError as error:
        raise InputError(f"{path}: expected certificates in PEM") from error


def _der(public_key: object) -> bytes:
    return public_key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)  # pyright: ignore


def _first_expiry_s(certificates: list[x509.Certificate]) -> float:
    return min(certificate.not_valid_after_utc.timestamp() for certificate in certificates)


class CertificateFiles:
    """The files as they are now. A change that cannot be used is logged and counted, and what was there stays.

    failures: changes that could not be used. Any thread.
    """

    def __init__(self, cert: Path | None, key: Path | None, ca: Path) -> None:
        """Raises InputError when they cannot be used now."""
        self._paths = (cert, key, ca)
        self.failures = 0
        self._files = WatchedFiles(filter(None, self._paths), lambda: read_certificates(*self._paths), self._read_anew)

    def current(self) -> Certificates:
        return self._files.current()

    def _read_anew(self, before: Certificates) -> Certificates:
        try:
            read = read_certificates(*self._paths)
        except InputError as error:  # such as a key that is replaced a moment after its certificate
            self.failures += 1
            _log.warning("certificates not read: those of before stay in use", extra=fields(detail=str(error)))
            return before
        _log.info("certificates read anew", extra=fields(expires_s=read.expires_s))
        return read
