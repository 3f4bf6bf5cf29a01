"""How a session's stream ends from this side: what the robot is told, what is logged, and what stays in memory."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from map_service.catalog import Catalog
from map_service.channel import Handed, Reply
from map_service.held import HeldSessions
from map_service.messages import refusal_word
from map_service.session import Session
from map_service.store import FencedError, Store, StoreError
from map_service.tally import Tally
from splitslam.logs import fields
from splitslam.wire import session_pb2 as pb

_log = logging.getLogger(__name__)


class Endings:
    """One for each worker; its messages go out by `send`."""

    def __init__(self, sessions: HeldSessions, store: Store, tally: Tally, send: Callable[[Any], None]) -> None:
        self._sessions, self._store, self._tally, self._send = sessions, store, tally, send

    def refused(self, stream: int, session_id: str, refused: pb.Refused) -> None:
        """There is no session on this stream, and the robot hears why."""
        reason = refusal_word(refused)
        self._tally.count("refused", reason)
        _log.warning("refused", extra=fields(session_id=session_id, reason=reason, detail=refused.detail))
        self._send(Reply(stream, pb.StreamResponse(refused=refused).SerializeToString(), last=True))

    def fenced(self, session: Session, error: Exception) -> None:
        """Another worker owns it now."""
        self._tally.count("fenced")
        _log.warning("fenced", extra=fields(session_id=session.request.session_id, detail=str(error)))
        self._sessions.abort(session, "ABORTED", f"fenced: {error}")
        self._sessions.drop(session.request.session_id)

    def store_failed(self, session: Session, error: Exception) -> None:
        """It could not be read: the robot comes again.

        Let go is only a session with a commit that is lost, or one half way through a frame, looking for a cloud.
        """
        _log.error("store failed", extra=fields(session_id=session.request.session_id, detail=str(error)))
        self._sessions.abort(session, "UNAVAILABLE", "the store does not answer")
        if session.log.broken or not session.settled:
            self._sessions.drop(session.request.session_id)

    def guarded(self, session: Session, action: Callable[[], None]) -> None:
        """Does something for a session whose error must not end the others'."""
        try:
            action()
        except FencedError as error:
            self.fenced(session, error)
        except StoreError as error:
            self.store_failed(session, error)
        except Exception:
            _log.exception("commit failed", extra=fields(session_id=session.request.session_id))
            self._sessions.abort(session, "INTERNAL", "the session cannot be committed: see the service's log")
            self._sessions.drop(session.request.session_id)

    def handed(self, session: Session) -> None:
        """Everything is durable: what the robot still sends on this stream is for the next replica."""
        if session.stream is not None:
            self._send(Handed(session.stream, session.log.durable_seq))
            self._sessions.detach(session.stream)

    def finished(self, session: Session) -> None:
        """Once the last commit is durable; a store that cannot be read just now is asked again."""
        try:
            row = Catalog(self._store).session(session.request.session_id)
        except StoreError:
            return
        if row is None:
            raise FencedError("the session was deleted")
        _log.info("session finished", extra=fields(session_id=row.session_id, mapped=row.frames))
        if session.stream is not None:
            finished = pb.Finished(
                mapped=row.frames, keyframes=row.keyframes, loops=row.loops, gnss_factors=row.gnss_factors
            )
            self._send(Reply(session.stream, pb.StreamResponse(finished=finished).SerializeToString(), last=True))
        self._sessions.drop(session.request.session_id)
