"""What a thread is at, for those who watch it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Pulse:
    """A thread works on one thing after the other, and waits in between.

    Waiting takes as long as it takes; a thing that is worked on for seconds is a thread that is stuck. A live source
    is at work on a packet, and waits for one. Written by its own thread only, read by others.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._since_s: float | None = None

    @contextmanager
    def working(self) -> Iterator[None]:
        """One thing to work on."""
        self._since_s = time.monotonic()
        try:
            yield
        finally:
            self._since_s = None

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Within `working`: for somebody else, such as the map service in lockstep."""
        self._since_s = None
        try:
            yield
        finally:
            self._since_s = time.monotonic()

    @property
    def busy_s(self) -> float:
        """For how long it has worked on the same thing; 0 while it waits."""
        since_s = self._since_s
        return 0.0 if since_s is None else time.monotonic() - since_s
