"""Certificates that count no more although they have not expired."""

from __future__ import annotations

import logging
import re
from pathlib import Path

from splitslam.config import read_text
from splitslam.errors import InputError
from splitslam.logs import fields
from splitslam.watched_files import WatchedFiles

_HEX_64 = re.compile(r"[0-9a-f]{64}")
_log = logging.getLogger(__name__)


class RevokedList:
    """SHA-256 fingerprints, hexadecimal, a line each; `#` begins a comment. Read anew when the file changes."""

    def __init__(self, path: Path) -> None:
        """Raises InputError when it cannot be read, or has a line that is none."""
        self._path = path
        self._prints = WatchedFiles((path,), lambda: _read(path), self._read_anew)

    def holds(self, fingerprint: str) -> bool:
        return fingerprint in self._prints.current()

    def _read_anew(self, before: frozenset[str]) -> frozenset[str]:
        """A file that can no longer be read changes nothing: nobody who was revoked comes back by that."""
        try:
            return _read(self._path)
        except InputError as error:
            _log.error("revoked certificates not read: those of before count", extra=fields(detail=str(error)))
            return before


def _read(path: Path) -> frozenset[str]:
    lines = [line.partition("#")[0].strip().lower() for line in read_text(path).splitlines()]
    wrong = next((line for line in lines if line and not _HEX_64.fullmatch(line)), None)
    if wrong is not None:
        raise InputError(f"{path}: {wrong[:80]!r}: expected the SHA-256 of a certificate, 64 hexadecimal digits")
    return frozenset(line for line in lines if line)
