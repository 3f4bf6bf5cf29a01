"""Frames whose answer has gone out, and which the map does not have yet."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

from map_service.session import Session
from splitslam.wire import session_pb2 as pb


@dataclass(frozen=True, slots=True, eq=False)
class Answered:
    """seconds: what the answer took."""

    session: Session
    frame: pb.Frame
    answer: pb.Odometry
    seconds: float


class AnsweredFrames:
    """At most one a session: its next frame waits until the map has this one."""

    def __init__(self) -> None:
        self._of: OrderedDict[int, Answered] = OrderedDict()  # by the session's id in memory

    def add(self, answered: Answered) -> None:
        self._of[id(answered.session)] = answered

    def take(self, session: Session) -> Answered | None:
        """That of this session, once."""
        return self._of.pop(id(session), None)

    def oldest(self) -> Answered | None:
        """The one that waits longest, once."""
        return self._of.popitem(last=False)[1] if self._of else None
