"""A flood of one line is counted, not printed."""

from __future__ import annotations

import copy
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

BURST, WINDOW_S = 20, 10.0
_Kind = tuple[str, int, str]  # logger, level, event


@dataclass(slots=True)
class _Window:
    ends_s: float
    passed: int = 0
    held: int = 0
    last: logging.LogRecord | None = None


class LogLimit(logging.Handler):
    """Passes lines on to another handler: of one event at most `burst` in each `window_s`.

    The others are counted. When the window is over the last of them comes with the field `repeated`: how many lines it
    stands for. `close`, as at exit, says what is still counted.
    """

    def __init__(
        self,
        target: logging.Handler,
        burst: int = BURST,
        window_s: float = WINDOW_S,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self._target, self._burst, self._window_s, self._clock_s = target, burst, window_s, clock_s
        self._windows: dict[_Kind, _Window] = {}
        self._timer: threading.Timer | None = None

    def emit(self, record: logging.LogRecord) -> None:
        now_s = self._clock_s()
        self.tell(now_s)
        kind = (record.name, record.levelno, str(record.msg))
        window = self._windows.setdefault(kind, _Window(now_s + self._window_s))
        if window.passed < self._burst:
            window.passed += 1
            self._target.handle(record)
            return
        window.held, window.last = window.held + 1, record
        if self._timer is None:
            self._wait()

    def tell(self, now_s: float) -> None:
        """Says what was held back in windows that are over, and forgets them."""
        over = [kind for kind, window in self._windows.items() if now_s >= window.ends_s]
        for window in [self._windows.pop(kind) for kind in over]:
            if window.last is not None:
                last = copy.copy(window.last)
                last.fields = {**getattr(last, "fields", {}), "repeated": window.held}
                self._target.handle(last)

    def _on_timer(self) -> None:
        self.acquire()
        try:
            self._timer = None
            self.tell(self._clock_s())
            if any(window.held for window in self._windows.values()):
                self._wait()
        finally:
            self.release()

    def _wait(self) -> None:
        self._timer = threading.Timer(self._window_s, self._on_timer)
        self._timer.daemon = True
        self._timer.start()

    def flush(self) -> None:
        self._target.flush()

    def close(self) -> None:
        self.acquire()
        try:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None
            self.tell(float("inf"))
        finally:
            self.release()
        self._target.close()
        super().close()
