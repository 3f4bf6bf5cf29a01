"""Files that are read anew when they have changed, as certificates, tokens and lists of who is revoked are."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Generic, TypeVar

T = TypeVar("T")


class WatchedFiles(Generic[T]):
    """What some files say together. Any thread may ask."""

    def __init__(self, paths: Iterable[Path], first: Callable[[], T], again: Callable[[T], T]) -> None:
        """first: reads them now, and may raise. again: reads them after a change; it is given what they said before and
        decides what counts when they cannot be read. It runs under a lock, once a change.
        """
        self._paths, self._again = tuple(paths), again
        self._lock = threading.Lock()
        self._seen = self._signatures()  # before they are read: a change meanwhile is then one more
        self._said = first()

    def current(self) -> T:
        """What they say now."""
        with self._lock:
            signatures = self._signatures()
            if signatures != self._seen:
                self._seen = signatures
                self._said = self._again(self._said)
            return self._said

    def _signatures(self) -> tuple[tuple[int, int, int] | None, ...]:
        return tuple(map(_signature, self._paths))


def _signature(path: Path) -> tuple[int, int, int] | None:
    """Changes when the file is written or replaced; None: it is not there."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_size
