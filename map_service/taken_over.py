"""Sessions that another replica goes on with: what this one still has of them in memory is of no use to anybody."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future

from map_service.catalog import Catalog
from map_service.session import Session

EVERY_S = 10.0


class TakenOver:
    """Looks now and then which of the sessions without a stream the store gives to somebody else."""

    def __init__(self, catalog: Catalog, every_s: float = EVERY_S) -> None:
        self._catalog, self._every_s = catalog, every_s
        self._looked_s = time.monotonic()
        self._look: Future[None] | None = None
        self._epochs: dict[int, int] = {}
        self._asked: set[int] = set()

    def of(self, sessions: Iterable[Session], run: Callable[[Callable[[], None]], Future[None]]) -> list[Session]:
        """Those that have a newer epoch in the store, or are not there any more. `run` asks it; nobody waits."""
        now_s = time.monotonic()
        if self._look is None:
            if now_s - self._looked_s >= self._every_s:
                self._looked_s = now_s
                self._asked = {session.log.key for session in sessions if session.stream is None}
                self._look = run(self._ask) if self._asked else None
            return []
        if not self._look.done():
            return []
        failed = self._look.exception() is not None  # a store that is away is others' to report
        self._look = None
        if failed:
            return []
        return [
            session
            for session in sessions
            if session.log.key in self._asked
            and session.stream is None
            and self._epochs.get(session.log.key, session.log.epoch + 1) > session.log.epoch
        ]

    def _ask(self) -> None:
        self._epochs = self._catalog.epochs(self._asked)
