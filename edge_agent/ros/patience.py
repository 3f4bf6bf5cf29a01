"""Waiting for what a robot starts at the same time as the agent."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable

from edge_agent.sources.source import StoppedError
from splitslam.logs import fields

_log = logging.getLogger(__name__)
_LOOK_S = 0.1
_TELL_S = 1.0
_SAY_S = 10.0


class Patience:
    """One wait. until_s: its end on the monotonic clock, infinite for a wait without one."""

    def __init__(self, wait_s: float | None, stop: threading.Event, tell: Callable[[str], None] | None = None) -> None:
        """wait_s: None: for ever. stop: ends it with StoppedError. tell: gets what is missing, once a second."""
        now_s = time.monotonic()
        self.until_s = math.inf if wait_s is None else now_s + wait_s
        self.stop = stop
        self._tell, self._tell_s = tell, now_s
        self._say_s = now_s + _SAY_S

    @property
    def over(self) -> bool:
        """There is no more time."""
        return time.monotonic() > self.until_s

    def pause(self, missing: str) -> None:
        """A moment. missing: what is waited for; said in the log every 10 s. Raises StoppedError on `stop`."""
        if self.stop.wait(_LOOK_S):
            raise StoppedError
        now_s = time.monotonic()
        if self._tell is not None and now_s >= self._tell_s:
            self._tell_s = now_s + _TELL_S
            self._tell(missing)
        if now_s >= self._say_s:
            self._say_s += _SAY_S
            _log.warning("not there yet: the agent waits", extra=fields(missing=missing))
