"""A session's frames on their way through the worker: answered first, taken into the map after."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from map_service.answered import Answered, AnsweredFrames
from map_service.channel import Reply
from map_service.endings import Endings
from map_service.held import HeldSessions
from map_service.session import SequenceGapError, Session
from map_service.store import StoreError
from map_service.tally import Tally
from map_service.views import SessionViews
from splitslam.logs import fields
from splitslam.wire import session_pb2 as pb

_SLOW_S = 1.0

_log = logging.getLogger(__name__)


class FrameFlow:
    """A frame that fails costs its session the stream: the pipeline's state cannot be trusted any more.

    The robot resumes from the store and sends the frame again; if it fails a second time it is rejected.
    """

    def __init__(
        self,
        sessions: HeldSessions,
        endings: Endings,
        views: SessionViews,
        tally: Tally,
        send: Callable[[Any], None],
    ) -> None:
        self._sessions, self._endings, self._views, self._tally, self._send = sessions, endings, views, tally, send
        self._answered = AnsweredFrames()
        self._failed: dict[str, int] = {}  # seq of the frame, by session

    def answer(self, session: Session, frame: pb.Frame) -> None:
        """Tells the robot where it is. Raises SequenceGapError and StoreError."""
        start_s = time.monotonic()
        try:
            answer = session.apply(frame, poisoned=self._failed.get(session.request.session_id) == frame.seq)
        except (SequenceGapError, StoreError):
            raise
        except Exception:
            self._fail(session, frame)
            return
        assert session.stream is not None
        self._send(Reply(session.stream, pb.StreamResponse(odometry=answer).SerializeToString(), answer=True))
        self._answered.add(Answered(session, frame, answer, time.monotonic() - start_s))

    def settle(self, session: Session) -> None:
        """The map takes the session's answered frame, if there is one."""
        self._settle(self._answered.take(session))

    def settle_oldest(self) -> bool:
        """The map takes the frame that has waited longest; False: none waits."""
        answered = self._answered.oldest()
        self._settle(answered)
        return answered is not None

    def settle_all(self) -> None:
        """The map takes every frame that was answered."""
        while self.settle_oldest():
            pass

    def forget(self, session: Session) -> None:
        """The run is over."""
        self._failed.pop(session.request.session_id, None)

    def _settle(self, answered: Answered | None) -> None:
        if answered is None:
            return
        session, frame, start_s = answered.session, answered.frame, time.monotonic()
        name = session.request.session_id
        self._views.scan(session, frame, answered.answer)
        try:
            session.settle()
        except StoreError as error:
            self._endings.store_failed(session, error)
            return
        except Exception:
            self._fail(session, frame)
            return
        if self._failed.get(name) == frame.seq:
            del self._failed[name]
        _note(session, frame, answered.answer, answered.seconds + time.monotonic() - start_s)

    def _fail(self, session: Session, frame: pb.Frame) -> None:
        name = session.request.session_id
        _log.exception("frame failed", extra=fields(session_id=name, seq=frame.seq, trace_id=_trace(frame)))
        self._tally.count("frames", "failed")
        self._failed[name] = frame.seq
        self._sessions.abort(session, "INTERNAL", f"frame {frame.seq} failed: see the service's log")
        self._sessions.drop(name)


def _note(session: Session, frame: pb.Frame, answer: pb.Odometry, seconds: float) -> None:
    """Each frame at debug; one that is not mapped, or takes long, for whoever looks after the service."""
    slow = seconds > _SLOW_S
    level = logging.WARNING if answer.rejected else logging.INFO if slow else logging.DEBUG
    if not _log.isEnabledFor(level):
        return
    event = "frame rejected" if answer.rejected else "frame slow" if slow else "frame"
    name = session.request.session_id
    said = {"state": session.state.name.lower(), "keyframe": answer.keyframe, "duplicate": answer.duplicate}
    said |= {"bytes": len(frame.payload), "ms": round(seconds * 1e3, 2)}
    if answer.rejected:
        said["reason"] = answer.rejected
    _log.log(level, event, extra=fields(session_id=name, seq=frame.seq, trace_id=_trace(frame), **said))


def _trace(frame: pb.Frame) -> str:
    """The agent's own word for the frame, if it has one; else it follows from run and seq."""
    return frame.trace_id[:64]
