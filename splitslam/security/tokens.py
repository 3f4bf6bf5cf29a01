"""Tokens: 256 random bits that stand for an identity. What is kept is their SHA-256.

A plain hash is enough: nobody guesses 256 bits, so there is nothing for a slow one to slow down.
"""

from __future__ import annotations

import hashlib
import hmac
import logging
import secrets
from pathlib import Path

from splitslam import config
from splitslam.errors import InputError
from splitslam.logs import fields
from splitslam.security.identity import Identity
from splitslam.watched_files import WatchedFiles

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
        self._hashes = WatchedFiles((path,), lambda: read_tokens(path), self._read_anew)

    def owner(self, token: str) -> Identity | None:
        """Compares with every entry in full, so that the time it takes tells nothing of any."""
        digest = hash_of(token)
        owner = None
        for uri, known in self._hashes.current().items():
            if hmac.compare_digest(digest, known):
                owner = uri
        return None if owner is None else Identity.parse(owner)

    def _read_anew(self, _: dict[str, str]) -> dict[str, str]:
        try:
            return read_tokens(self._path)
        except InputError as error:  # who is to be believed is not known: nobody
            _log.error("tokens not read: none is believed until they are mended", extra=fields(detail=str(error)))
            return {}
