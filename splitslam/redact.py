"""Takes secrets out of what leaves the machine: by the name of a key, by what a value looks like, and by value."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

GONE = "<redacted>"
_WORDS = frozenset(
    ("password", "passwd", "passphrase", "pass", "pwd", "secret", "secrets", "token", "tokens", "key", "keys", "apikey")
    + ("credential", "credentials", "auth", "authorization", "bearer", "cookie", "psk", "pin", "private", "signature")
)
_SPLIT = re.compile(r"[^a-z0-9]+")
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_SUFFIXES = frozenset(("pem", "crt", "cert", "key", "p12", "pfx", "token", "yaml", "json", "txt"))
_SHORTEST = 6  # one that is shorter would take pieces out of every text

_MOST_BYTES = 2**16  # of a file with a key or a token

_URL_USER = re.compile(r"(\b[a-z][a-z0-9+.-]*://)([^/\s@'\"]+)@", re.IGNORECASE)
_PEM = re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(?:-----END [A-Z ]*PRIVATE KEY-----|\Z)", re.DOTALL)
_JWT = re.compile(r"\beyJ[\w-]{8,}\.[\w-]+\.[\w-]*")
_BEARER = re.compile(r"\b(bearer|basic)\s+[\w~+/=.-]{8,}", re.IGNORECASE)
_ASSIGNED = re.compile(
    r"([\w.-]*(?:passw(?:or)?d|passphrase|secret|token|api[_-]?key|private[_-]?key|authorization|credential)[\w.-]*"
    r"[\"']?\s*[:=]\s*)(\"[^\"]*\"|'[^']*'|[^\s,;&\"'}]+)",
    re.IGNORECASE,
)


def is_secret_name(name: str, of_number: bool = False) -> bool:
    """Whether a key or a variable of that name holds a secret: one of its words says so.

    of_number: the value is a number: `reset_keys: 100` counts keys of another kind.
    """
    words = _WORDS - {"key", "keys"} if of_number else _WORDS
    return not words.isdisjoint(_SPLIT.split(_CAMEL.sub("_", name).lower()))


class Redactor:
    """Learns secrets from configurations and environments, and knows them again in any text.

    Where a secret lies is none: absolute paths to files stay.
    """

    def __init__(self) -> None:
        self._known: set[str] = set()

    def mapping(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """A copy without secrets; they are learnt."""
        return self._mapping(data, secret=False)

    def environment(self, variables: Mapping[str, str], shown: Iterable[str]) -> dict[str, str]:
        """The variables whose names begin with one of `shown`, without secrets; all of them are learnt from."""
        clean = self.mapping(variables)
        return {name: value for name, value in sorted(clean.items()) if name.startswith(tuple(shown))}

    def _mapping(self, data: Mapping[str, Any], secret: bool) -> dict[str, Any]:
        """secret: the name above says so of all that is below it."""
        return {
            str(key): self._value(value, secret or is_secret_name(str(key), isinstance(value, int | float)))
            for key, value in data.items()
        }

    def _value(self, value: Any, secret: bool) -> Any:
        if isinstance(value, Mapping):
            return self._mapping(value, secret)
        if isinstance(value, list | tuple):
            return [self._value(item, secret) for item in value]
        if value is None or isinstance(value, bool):
            return value
        if secret and _is_path(value):
            self._learn_file(Path(value))
        elif secret:
            self._learn(str(value))
            return GONE
        if not isinstance(value, str):
            return value
        for _, user in _URL_USER.findall(value):
            self._learn(user.partition(":")[2])
        return self.text(value)

    def _learn(self, secret: str) -> None:
        for form in (secret, unquote(secret), *secret.splitlines()):
            if len(form.strip()) >= _SHORTEST:
                self._known.add(form.strip())

    def _learn_file(self, path: Path) -> None:
        """What lies where a secret should: each line of it."""
        with contextlib.suppress(OSError, ValueError):
            if path.is_file() and path.stat().st_size <= _MOST_BYTES:
                self._learn(path.read_text())

    def text(self, text: str) -> str:
        """The text without what looks like a secret, and without every secret that is known."""
        text = _PEM.sub(GONE, text)
        text = _URL_USER.sub(rf"\1{GONE}@", text)
        text = _JWT.sub(GONE, text)
        text = _BEARER.sub(rf"\1 {GONE}", text)
        text = _ASSIGNED.sub(_assigned, text)
        for secret in sorted(self._known, key=len, reverse=True):
            text = text.replace(secret, GONE)
        return text


def _assigned(found: re.Match[str]) -> str:
    """`token: "abc"` -> `token: "<redacted>"`."""
    value = found[2]
    quote = value[0] if value[0] in "\"'" else ""
    return found[0] if _is_path(value.strip(quote or None)) else f"{found[1]}{quote}{GONE}{quote}"


def _is_path(value: object) -> bool:
    if isinstance(value, Path):
        return True
    text = str(value)
    if not text.startswith("/") or len(text) > 4096 or any(c.isspace() for c in text):
        return False
    return text.rpartition(".")[2] in _SUFFIXES or Path(text).exists()
