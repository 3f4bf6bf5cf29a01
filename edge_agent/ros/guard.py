"""What fails in the thread of a graph costs the message that it failed at, and not all that come after it."""

from __future__ import annotations

import logging
from collections import Counter

from edge_agent.ros.graph import Receive
from splitslam.logs import fields

_log = logging.getLogger(__name__)


class Guard:
    """Counts what fails as `ros_failed`; of each topic, and of the middleware, the first is logged."""

    def __init__(self, lost: Counter[str]) -> None:
        self._lost = lost
        self._said: set[str] = set()

    def guarded(self, topic: str, receive: Receive) -> Receive:
        """`receive`, which never raises."""

        def call(raw: bytes) -> None:
            try:
                receive(raw)
            except Exception:
                self.failed(topic)

        return call

    def failed(self, what: str) -> None:
        """To be called where the exception is handled. what: a topic, or the middleware's name."""
        self._lost["ros_failed"] += 1
        if what not in self._said:
            self._said.add(what)
            _log.exception("ROS messages fail", extra=fields(topic=what))
