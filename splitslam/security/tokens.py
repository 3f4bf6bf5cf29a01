"""Tokens: 256 random bits that stand for an identity. What is kept is their SHA-256.

A plain hash is enough: nobody guesses 256 bits, so there is nothing for a slow one to slow down.
"""

from __future__ import annotations

import hashlib
import hmac
import logging
import secrets
import threading
from pathlib import Path

from splitslam import config
from splitslam.errors import InputError
from splitslam.security.identity import Identity

_log = logging.getLogger(__name__)
SCHEME = "Bearer "


def new_token() -> str:
    """43 characters of URL-safe base64."""
    return secrets.token_urlsafe(32)


def hash_of(token: str) -> str:
    """SHA-256, hexadecimal."""
    return hashlib.sha256(token.encode()).hexdigest()


def read_tokens(path: Path) -> dict[str, str]:
    """identity URI -> hash. Raises InputError that names the line's key."""
    table = config.parse_yaml(config.read_text(path), str(path))
    for uri, digest in table.items():
        try:
            Identity.parse(str(uri))
        except ValueError as error:
            raise InputError(f"{path}: {error}") from None
        if not isinstance(digest, str) or len(digest) != 64 or not set(digest) <= set("0123456789abcdef"):
            raise InputError(f"{path}: {uri}: expected the SHA-256 of a token, 64 hexadecimal digits")
    return {str(uri): str(digest) for uri, digest in table.items()}


class TokenTable:
    """Who has which token, by the file as it is now: a line that is taken out is a token revoked."""

    def __init__(self, path: Path) -> None:
        """Raises InputError when the file cannot be used."""
        self._path = path
        self._lock = threading.Lock()
        self._seen = self._signature()
        self._hashes = read_tokens(path)

    def owner(self, token: str) -> Identity | None:
        """Compares with every entry in full, so that the time it takes tells nothing of any."""
        digest = hash_of(token)
        owner = None
        for uri, known in self._table().items():
            if hmac.compare_digest(digest, known):
                owner = uri
        return None if owner is None else Identity.parse(owner)

    def _table(self) -> dict[str, str]:
        with self._lock:
            signature = self._signature()
            if signature != self._seen:
                self._seen = signature
                try:
                    self._hashes = read_tokens(self._path)
                except InputError as error:
                    self._hashes = {}  # who is to be believed is not known: nobody
                    _log.error("tokens: %s; no token is believed until it is mended", error)
            return self._hashes

    def _signature(self) -> tuple[int, int] | None:
        try:
            status = self._path.stat()
        except OSError:
            return None
        return status.st_ino, status.st_mtime_ns
