"""What a worker's pipeline thread does with the front's messages: sessions opened, fed, committed, handed over."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from google.protobuf.message import DecodeError as WireError

from map_service.catalog import Catalog
from map_service.channel import Abort, Close, DrainAll, Forget, HandOver, Open, Reply, Request, Watch
from map_service.commits import FLUSH_S, Committer
from map_service.config import ServiceConfig
from map_service.endings import Endings
from map_service.engine import Engine
from map_service.frame_flow import FrameFlow
from map_service.held import HeldSessions
from map_service.hello import RefusedError
from map_service.opening import Opener
from map_service.quota import SiteQuotas
from map_service.session import SequenceGapError, Session
from map_service.store import FencedError, FinishedError, Store, StoreError
from map_service.taken_over import TakenOver
from map_service.tally import Tally
from map_service.types import StateVersionError
from map_service.views import SessionViews
from splitslam.logs import fields
from splitslam.wire import session_pb2 as pb

STORE_RETRY_MS = 500
VERSION_RETRY_MS = 500

_log = logging.getLogger(__name__)


class SessionHost:
    """Answers go out by `send`. `sessions` and `tally` are read by other threads; `closed` is filled by who reads them.

    What a frame means for the map, and what is to be committed, can wait while other robots wait for an answer: `care`
    does a piece of it. A session is cared for before its next frame at the latest.
    """

    def __init__(self, config: ServiceConfig, engine: Engine, store: Store, send: Callable[[Any], None]) -> None:
        self.config, self.engine, self.store, self.tally = config, engine, store, Tally()
        self.sessions = HeldSessions(config.limits, send)
        self.closed: set[int] = set()  # streams that ended while their Open was still queued
        self._send, self._views = send, SessionViews(send)
        self._endings = Endings(self.sessions, store, self.tally, send)
        self._committer = Committer(store, config.commit, self.tally)
        self._quotas = SiteQuotas(config.quota, Catalog(store))
        self._opener = Opener(self.sessions, engine, store, self._committer, self._quotas, self.tally, self.cpu_ns)
        self._taken_over = TakenOver(Catalog(store))
        self._frames = FrameFlow(self.sessions, self._endings, self._views, self.tally, send)

    def cpu_ns(self) -> int:
        """CPU time of this process and its loop verifiers."""
        return time.process_time_ns() + self.engine.pool_cpu_ns()

    # -- messages -----------------------------------------------------------------------------------------------

    def handle(self, message: Any) -> None:
        if isinstance(message, Request):
            self._request(message)
            return
        self._frames.settle_all()
        match message:
            case Open():
                self._open(message)
            case Close(stream):
                self.closed.discard(stream)
                self.sessions.detach(stream)
            case Forget(session_id):
                self.sessions.drop(session_id)
            case HandOver(stream):
                self._hand_over(stream)
            case Watch():
                self._views.watch(message)
            case DrainAll():
                pass

    def _open(self, message: Open) -> None:
        if message.stream in self.closed:
            return
        try:
            session = self._opener.open(message.hello)
        except RefusedError as refusal:
            self._endings.refused(message.stream, message.session_id, refusal.message)
        except FinishedError:
            detail = "the session has ended and is read-only"
            refusal = pb.Refused(reason=pb.REFUSED_REASON_FINISHED, detail=detail)
            self._endings.refused(message.stream, message.session_id, refusal)
        except StoreError as error:
            detail = f"store: {error}"[:200]
            refusal = pb.Refused(reason=pb.REFUSED_REASON_STORE, detail=detail, retry_after_ms=STORE_RETRY_MS)
            self._endings.refused(message.stream, message.session_id, refusal)
        except StateVersionError as error:  # in the middle of an upgrade the robot is better off elsewhere
            detail = f"the session is of another release: {error}"
            refusal = pb.Refused(reason=pb.REFUSED_REASON_VERSION, detail=detail, retry_after_ms=VERSION_RETRY_MS)
            self._endings.refused(message.stream, message.session_id, refusal)
        except Exception:
            _log.exception("session cannot be opened", extra=fields(session_id=message.session_id))
            self.sessions.drop(message.session_id)
            self._send(Abort(message.stream, "INTERNAL", "the session cannot be opened: see the service's log"))
        else:
            self._attach(session, message.stream)

    def _attach(self, session: Session, stream: int) -> None:
        self.sessions.attach(session, stream)
        name, log = (
            session.request.session_id,
            session.log,
        )  # said before the robot, which may go on at once
        _log.info("session open", extra=fields(session_id=name, epoch=log.epoch, durable_seq=log.durable_seq))
        self._send(Reply(stream, pb.StreamResponse(welcome=session.welcome()).SerializeToString()))
        if self.config.advice.max_kbps:
            advice = pb.Advice(max_kbps=self.config.advice.max_kbps)
            self._send(Reply(stream, pb.StreamResponse(advice=advice).SerializeToString()))

    def _request(self, message: Request) -> None:
        session = self.sessions.on(message.stream)
        if session is None:  # its stream was ended from this side; the robot resumes
            return
        session.accounts.note_front(message.front_cpu_ns)
        try:
            request = pb.StreamRequest.FromString(message.body)
        except WireError:
            self.sessions.abort(session, "INVALID_ARGUMENT", "not a StreamRequest")
            return
        kind = request.WhichOneof("message")
        if kind == "report":
            session.accounts.note_edge(request.report)
        elif kind not in ("frame", "bye") or session.finishing:
            after = "Bye" if session.finishing else "Hello"
            self.sessions.abort(session, "INVALID_ARGUMENT", f"{kind or 'an empty message'} after {after}")
        elif session.held or (kind == "frame" and session.log.full):
            self._hold(session, request)
        else:
            self._take(session, request)

    def _hold(self, session: Session, request: pb.StreamRequest) -> None:
        """Unanswered, and so without credit for more: the robot keeps what comes after the window."""
        if not session.held:
            name, log = session.request.session_id, session.log
            _log.warning("waiting for the store", extra=fields(session_id=name, durable_seq=log.durable_seq))
        session.held.append(request)
        if len(session.held) > self.config.limits.window_frames + 1:  # and a Bye
            self.sessions.abort(session, "INVALID_ARGUMENT", "more than the window allows")

    def _take(self, session: Session, request: pb.StreamRequest) -> None:
        self._frames.settle(session)
        if session.stream is None:  # what its last frame means could not be done: the robot resumes
            return
        try:
            if session.commit_due:
                session.commit()
            if request.HasField("frame"):
                self._frames.answer(session, request.frame)
            else:
                self._bye(session, request.bye)
        except SequenceGapError as gap:
            self.sessions.abort(session, "ABORTED", str(gap))
        except FencedError as error:
            self._endings.fenced(session, error)
        except StoreError as error:
            self._endings.store_failed(session, error)

    def _bye(self, session: Session, bye: pb.Bye) -> None:
        if bye.last_seq != session.log.applied_seq:
            raise SequenceGapError(session.log.applied_seq + 1, bye.last_seq + 1)
        self._frames.forget(session)
        session.finish()
        self._views.end(session)

    # -- care ---------------------------------------------------------------------------------------------------

    def care(self) -> bool:
        """One piece of what can wait until no robot waits for an answer. False: there is nothing left."""
        if self._frames.settle_oldest():
            return True
        for session in self.sessions.all():
            if session.commit_due and not session.finishing:
                self._endings.guarded(session, session.commit)
                return True
        return False

    def look_after(self) -> None:
        """While there is time: what became of commits, sessions nobody came back to."""
        for session in self.sessions.all():
            self._endings.guarded(session, partial(self._look_after, session))
        self._keep_quotas()
        for session in self._taken_over.of(self.sessions.all(), self._committer.run):
            self.sessions.drop(session.request.session_id)
        self.sessions.evict()

    def _look_after(self, session: Session) -> None:
        session.log.collect()
        if session.finishing:
            if not session.log.waiting:
                self._endings.finished(session)
            return
        if session.leaving and not session.log.waiting:
            self._endings.handed(session)
        while session.held and session.stream is not None and not session.log.full:
            self._take(session, session.held.popleft())

    def _keep_quotas(self) -> None:
        """Sites that have reached their quota: what is applied is committed, then their robots keep what comes."""
        if not self._quotas.looked(self._committer.run):
            return
        self._frames.settle_all()
        for session in self.sessions.all():
            if session.stream is None or session.finishing:
                continue
            try:
                self._quotas.check(session.request.opening.site_id)
            except RefusedError as refusal:
                session.commit()
                stream = session.stream
                self.sessions.detach(stream)
                self._endings.refused(stream, session.request.session_id, refusal.message)

    # -- handing over -------------------------------------------------------------------------------------------

    def _hand_over(self, stream: int) -> None:
        """One session, to another replica, once it is durable. It stays in memory, should the robot come back."""
        session = self.sessions.on(stream)
        if session is not None:  # else its stream was ended meanwhile
            session.commit()
            session.leaving = True

    def drain(self) -> None:
        """All sessions: the commits are under way together, each robot goes as soon as its own is durable."""
        self._frames.settle_all()
        self._committer.give_up_after(self.config.commit.drain_s)
        sessions = sorted(self.sessions.all(), key=lambda session: session.stream is None)
        for session in sessions:
            session.commit()
        for session in sessions:
            try:
                session.log.flush(self.config.commit.drain_s + FLUSH_S)
                if session.finishing:
                    self._endings.finished(session)
                self._endings.handed(session)
            except (FencedError, StoreError) as error:
                name = session.request.session_id
                _log.error("not committed at drain", extra=fields(session_id=name, detail=str(error)))
