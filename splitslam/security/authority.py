"""The private certificate authority of one fleet: a folder with its key and everything it has signed.

FOLDER/ca.pem, ca.key; robots/NAME.pem, NAME.key; operators/NAME.pem, .key; service.pem, .key; envoy.pem, .key;
tokens.yaml and revoked.txt for the service. Keys are ECDSA P-256, files mode 0600.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Self

import yaml
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from splitslam.errors import InputError
from splitslam.security.certificates import identity_of
from splitslam.security.identity import FLEET, Identity
from splitslam.security.private_files import make_private_folder, write_private
from splitslam.security.tokens import hash_of, new_token, read_tokens

CA, CA_KEY, TOKENS, REVOKED = "ca.pem", "ca.key", "tokens.yaml", "revoked.txt"
_HOST = re.compile(r"(?:\*\.)?[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")
_EARLIER = timedelta(minutes=5)  # clocks of robots are not alike
# who calls and who is called: a robot's certificate must not do for a server
_USAGE = {
    "robot": [ExtendedKeyUsageOID.CLIENT_AUTH],
    "operator": [ExtendedKeyUsageOID.CLIENT_AUTH],
    "service": [ExtendedKeyUsageOID.SERVER_AUTH],
    "envoy": [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH],
}


@dataclass(frozen=True, slots=True)
class Issued:
    """A certificate as it lies in the folder."""

    path: Path
    certificate: x509.Certificate

    @property
    def identity(self) -> Identity | None:
        """None: the authority itself."""
        return None if _is_ca(self.certificate) else identity_of(self.certificate)

    @property
    def expires(self) -> datetime:
        return self.certificate.not_valid_after_utc

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the certificate, hexadecimal."""
        return self.certificate.fingerprint(hashes.SHA256()).hex()


class Authority:
    """An authority that is there. Raises InputError for a folder without one."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            self._certificate = x509.load_pem_x509_certificate((folder / CA).read_bytes())
            key = load_pem_private_key((folder / CA_KEY).read_bytes(), None)
        except OSError as error:
            detail = f"{error.filename}: {error.strerror}"
            raise InputError(f"{detail}: expected an authority of `splitslam certs init`") from error
        except (ValueError, TypeError) as error:
            raise InputError(f"{folder}: {CA}, {CA_KEY}: expected PEM: {error}") from error
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        self._key = key

    @classmethod
    def make(cls, folder: Path, fleet: str, days: float) -> Self:
        """A new one. Raises InputError when there is one already, or for a name that cannot be a fleet's."""
        if not FLEET.fullmatch(fleet):
            raise InputError(f"--fleet {fleet!r}: expected 1 to 63 of a-z 0-9 . _ -, a letter or digit first")
        if (folder / CA).exists() or (folder / CA_KEY).exists():
            raise InputError(f"{folder}: expected no authority there: whoever has its certificates would be locked out")
        make_private_folder(folder)
        key = ec.generate_private_key(ec.SECP256R1())
        name = _name(f"SplitSLAM fleet {fleet}")
        builder = _builder(name, name, key, days).add_extension(x509.BasicConstraints(ca=True, path_length=0), True)
        builder = builder.add_extension(_key_usage(signs=True), True)
        names = x509.SubjectAlternativeName([x509.UniformResourceIdentifier(f"spiffe://{fleet}")])
        certificate = builder.add_extension(names, False).sign(key, hashes.SHA256())
        write_private(folder / CA_KEY, _pem(key))
        write_private(folder / CA, certificate.public_bytes(Encoding.PEM))
        write_private(folder / TOKENS, b"")
        write_private(folder / REVOKED, b"")
        return cls(folder)

    @property
    def fleet(self) -> str:
        names = self._certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        return names.get_values_for_type(x509.UniformResourceIdentifier)[0].removeprefix("spiffe://")

    def issue(self, identity: Identity, days: float, hosts: Sequence[str] = ()) -> Issued:
        """A certificate with a new key; one that is there is replaced. hosts: names and addresses it serves under."""
        path = self._path(identity)
        self._check_free(identity)
        make_private_folder(path.parent)
        key = ec.generate_private_key(ec.SECP256R1())
        alternatives = [x509.UniformResourceIdentifier(identity.uri), *(_host(host) for host in hosts)]
        subject = _name(identity.name or identity.role)
        certificate = (
            _builder(subject, self._certificate.subject, key, days)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), True)
            .add_extension(_key_usage(signs=False), True)
            .add_extension(x509.ExtendedKeyUsage(_USAGE[identity.role]), False)
            .add_extension(x509.SubjectAlternativeName(alternatives), False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), False)
            .sign(self._key, hashes.SHA256())
        )
        write_private(path.with_suffix(".key"), _pem(key))
        write_private(path, certificate.public_bytes(Encoding.PEM))
        return Issued(path, certificate)

    def renew(self, issued: Issued, days: float | None = None) -> Issued:
        """The same identity and hosts, a new key; days: None: as long as before."""
        identity = issued.identity
        if identity is None:
            raise InputError(f"{issued.path}: expected not the authority: a new one is a new fleet")
        span = issued.expires - issued.certificate.not_valid_before_utc - _EARLIER
        names = issued.certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        hosts = [*names.get_values_for_type(x509.DNSName), *map(str, names.get_values_for_type(x509.IPAddress))]
        return self.issue(identity, span / timedelta(days=1) if days is None else days, hosts)

    def issued(self) -> list[Issued]:
        """Everything in the folder, the authority first. Raises InputError for a file that is no certificate."""
        found = []
        for path in (self.folder / CA, *sorted(p for p in self.folder.rglob("*.pem") if p.name != CA)):
            found.append(self.read(path))
        return found

    def valid(self, identity: Identity) -> Issued | None:
        """Its certificate here, unless that has expired or is revoked. Raises InputError as `issue` does."""
        self._check_free(identity)
        path, revoked = self._path(identity), self.folder / REVOKED
        if not path.exists():
            return None
        issued = self.read(path)
        gone = issued.expires < datetime.now(UTC) or (revoked.exists() and issued.fingerprint in revoked.read_text())
        return None if gone else issued

    def read(self, path: Path) -> Issued:
        """Raises InputError for a file that is none of this authority's certificates."""
        try:
            certificate = x509.load_pem_x509_certificate(path.read_bytes())
            certificate.verify_directly_issued_by(self._certificate)
            issued = Issued(path, certificate)
            _ = issued.identity
        except OSError as error:
            raise InputError(f"{path}: cannot read: {error.strerror}") from error
        except Exception as error:  # of cryptography, each parser its own
            raise InputError(f"{path}: expected a certificate of fleet {self.fleet}") from error
        return issued

    def revoke(self, issued: Issued) -> None:
        """From now on the service takes it no more (`tls.revoked`)."""
        path = self.folder / REVOKED
        lines = path.read_text() if path.exists() else ""
        if issued.fingerprint not in lines:
            write_private(path, f"{lines}{issued.fingerprint}  # {issued.identity}\n".encode())

    def token(self, identity: Identity) -> str:
        """A new token; the one that the identity had before counts no more."""
        self._check_free(identity)
        path = self.folder / TOKENS
        table = (read_tokens(path) if path.exists() else {}) | {identity.uri: hash_of(token := new_token())}
        write_private(path, yaml.safe_dump(table, width=200).encode())
        return token

    def _check_free(self, identity: Identity) -> None:
        """A session is known by its robot's name alone, so a name is one robot's in all sites."""
        path, tokens = self._path(identity), self.folder / TOKENS
        known = [str(self.read(path).identity)] if path.exists() else []
        known += read_tokens(tokens) if tokens.exists() else []
        for uri in known:
            other = Identity.parse(uri)
            if (other.role, other.name) == (identity.role, identity.name) and other != identity:
                raise InputError(f"{identity}: expected another name, this one is {other}'s")

    def _path(self, identity: Identity) -> Path:
        if identity.role in ("service", "envoy"):
            return self.folder / f"{identity.role}.pem"
        return self.folder / f"{identity.role}s" / f"{identity.name}.pem"


def _is_ca(certificate: x509.Certificate) -> bool:
    return certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, days: float
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLIER)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False)
    )


def _key_usage(signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        key_cert_sign=signs,
        crl_sign=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text[:64])])


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    if not _HOST.fullmatch(host):
        raise InputError(f"--host {host!r}: expected a name or an address, without port")
    return x509.DNSName(host)


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
