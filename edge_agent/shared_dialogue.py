"""A session's dialogue, and who waits for what in it."""

from __future__ import annotations

import threading

from edge_agent.dialogue import Dialogue
from edge_agent.stream import Stream


class SharedDialogue:
    """lock: guards all of it; the three conditions are on it.

    changed: for callers: an answer, or the end. to_say: for the stream's sender. broken: for the supervisor. Waking a
    thread for nothing costs as much as a call. stream: the one that is open; its callbacks are outdated without it.
    """

    def __init__(self, dialogue: Dialogue) -> None:
        self.lock = lock = threading.RLock()
        self.changed = threading.Condition(lock)
        self.to_say = threading.Condition(lock)
        self.broken = threading.Condition(lock)
        self.dialogue = dialogue
        self.stream: Stream | None = None
        self.failure: Exception | None = None
        self.closing = False

    @property
    def over(self) -> bool:
        """Nobody need wait any more."""
        return self.closing or self.failure is not None

    def fail(self, error: Exception) -> None:
        """For good: whoever waits must hear of it."""
        self.failure = error
        self.tell_all()

    def raise_failure(self) -> None:
        if self.failure is not None:
            raise self.failure

    def tell_all(self) -> None:
        for waiting in (self.changed, self.to_say, self.broken):
            waiting.notify_all()
