"""Messages between the graph's thread, which must not wait, and the reader, which decodes."""

from __future__ import annotations

import itertools
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass

_TICK_S = 0.005  # one call of the loop costs far more than one sample


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message as it came. arrival_ns: `time.monotonic_ns()`."""

    topic: str
    arrival_ns: int
    raw: bytes


class Inbox:
    """A queue bounded by bytes: the oldest message goes, and is counted in `dropped`."""

    def __init__(self, max_bytes: int, dropped: Counter[str]) -> None:
        self._max_bytes, self._dropped = max_bytes, dropped
        self._messages: deque[RawMessage] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._closed = False

    def put(self, topic: str, raw: bytes) -> None:
        """From the graph's thread."""
        message = RawMessage(topic, time.monotonic_ns(), raw)
        with self._changed:
            self._messages.append(message)
            self._bytes += len(raw)
            while self._bytes > self._max_bytes and len(self._messages) > 1:
                self._bytes -= len(self._messages.popleft().raw)
                self._dropped["ros_inbox_full"] += 1
            self._changed.notify_all()

    def take(self, timeout_s: float) -> list[RawMessage]:
        """Everything that has come, what comes within a tick together; empty after the timeout or when closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._messages or self._closed, timeout_s)
        time.sleep(_TICK_S)
        with self._changed:
            messages = list(self._messages)
            self._messages.clear()
            self._bytes = 0
        return messages

    def first(self, topic: str, count: int) -> list[RawMessage]:
        """The first messages on a topic, at most `count`; they stay."""
        with self._changed:
            return list(itertools.islice((message for message in self._messages if message.topic == topic), count))

    @property
    def closed(self) -> bool:
        return self._closed

    def close(self) -> None:
        """Nobody waits any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
