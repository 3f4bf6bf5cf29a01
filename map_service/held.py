"""The sessions that a worker has in memory, and the streams on which their robots are."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from map_service.channel import Abort, RobotStanding
from map_service.config import LimitsConfig
from map_service.session import Session


class HeldSessions:
    """Sessions by name, their streams by number. One thread changes them; what says so may be read by any."""

    def __init__(self, limits: LimitsConfig, send: Callable[[Any], None]) -> None:
        """send: to the front."""
        self._limits, self._send = limits, send
        self._sessions: dict[str, Session] = {}
        self._streams: dict[int, str] = {}
        self._released: list[str] = []

    # -- read by other threads ----------------------------------------------------------------------------------

    def durable(self) -> dict[int, int]:
        """durable_seq by stream."""
        sessions = dict(self._sessions)
        streams = dict(self._streams).items()
        return {stream: sessions[name].log.durable_seq for stream, name in streams if name in sessions}

    def states(self) -> dict[str, int]:
        """Sessions by tracking state; "detached": without a stream."""
        states: dict[str, int] = {}
        for session in dict(self._sessions).values():
            name = "detached" if session.stream is None else session.state.name.lower()
            states[name] = states.get(name, 0) + 1
        return states

    def robots(self) -> list[RobotStanding]:
        """Each session as it stands, for gauges by robot."""
        return [session.standing() for session in dict(self._sessions).values()]

    @property
    def undurable_frames(self) -> int:
        return sum(session.log.undurable for session in dict(self._sessions).values())

    def take_released(self) -> list[str]:
        """Sessions let go since the last call, and not held again."""
        released, self._released = self._released, []
        return [name for name in released if name not in self._sessions]

    @property
    def committing(self) -> bool:
        return any(session.log.waiting for session in dict(self._sessions).values())

    # -- the one thread -----------------------------------------------------------------------------------------

    def all(self) -> list[Session]:
        return list(self._sessions.values())

    def get(self, session_id: str) -> Session | None:
        return self._sessions.get(session_id)

    def on(self, stream: int) -> Session | None:
        """The session of a stream; None when the stream was ended from this side."""
        return self._sessions.get(self._streams.get(stream, ""))

    def add(self, session: Session) -> None:
        self._sessions[session.request.session_id] = session

    def attach(self, session: Session, stream: int) -> None:
        """Its robot is there."""
        session.stream, session.touched_s = stream, time.monotonic()
        self._streams[stream] = session.request.session_id

    def detach(self, stream: int) -> None:
        """The stream is over; the session stays."""
        session = self._sessions.get(self._streams.pop(stream, ""))
        if session is not None and session.stream == stream:
            session.stream, session.touched_s = None, time.monotonic()
            session.leaving = False
            session.held.clear()  # not applied: the robot sends them again

    def abort(self, session: Session, status: str, detail: str) -> None:
        """Ends the session's stream, if it has one; the robot resumes."""
        if session.stream is not None:
            self._send(Abort(session.stream, status, detail))
            self.detach(session.stream)

    def drop(self, session_id: str) -> None:
        """Lets it go: what the store has of it is all there is."""
        session = self._sessions.pop(session_id, None)
        if session is not None:
            if session.stream is not None:
                self.detach(session.stream)
            self._released.append(session_id)

    def evict(self) -> None:
        """Lets go of sessions that nobody came back to, and of the oldest of too many; durable ones only."""
        now_s = time.monotonic()
        detached = sorted((s for s in self._sessions.values() if s.stream is None), key=lambda s: s.touched_s)
        for position, session in enumerate(detached):
            too_many = len(detached) - position > self._limits.held_sessions
            done = not session.log.undurable and not session.log.waiting
            if (too_many or now_s - session.touched_s > self._limits.idle_s) and done:
                self.drop(session.request.session_id)
