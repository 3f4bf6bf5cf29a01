"""The sessions and streams of one worker: opened, fed, committed, let go. Single-threaded but for what says so."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from google.protobuf.message import DecodeError as WireError

from map_service.accounts import SessionAccounts
from map_service.catalog import Catalog
from map_service.channel import Abort, Close, DrainAll, Forget, Handed, HandOver, Open, Reply, Request
from map_service.commits import FLUSH_S, Committer
from map_service.config import ServiceConfig
from map_service.engine import Engine
from map_service.hello import RefusedError, SessionRequest, read_hello
from map_service.quota import SiteQuotas
from map_service.session import SequenceGapError, Session
from map_service.store import FencedError, FinishedError, Store, StoreError
from map_service.tally import Tally
from splitslam.trace import trace_id
from splitslam.wire import session_pb2 as pb

STORE_RETRY_MS = 500

_log = logging.getLogger(__name__)


class SessionHost:
    """What a worker's pipeline thread does with the front's messages; answers go out by `send`.

    Read by other threads: `durable`, `states`, `take_released`; `closed` is filled by the reader.
    """

    def __init__(self, config: ServiceConfig, engine: Engine, store: Store, send: Callable[[Any], None]) -> None:
        self.config, self.engine, self.store, self.tally = config, engine, store, Tally()
        self.sessions: dict[str, Session] = {}
        self.streams: dict[int, str] = {}
        self.closed: set[int] = set()  # streams that ended while their Open was still queued
        self._send = send
        self._committer = Committer(store, config.commit, self.tally)
        self._quotas = SiteQuotas(config.quota, Catalog(store))
        self._leaving: set[int] = set()  # streams whose sessions are being handed over
        self._released: list[str] = []
        self._poison: dict[str, int] = {}

    # -- what the other threads read ----------------------------------------------------------------------------

    def durable(self) -> dict[int, int]:
        """durable_seq by stream."""
        sessions = dict(self.sessions)
        return {
            stream: sessions[name].log.durable_seq for stream, name in dict(self.streams).items() if name in sessions
        }

    def states(self) -> dict[str, int]:
        """Sessions by tracking state; "detached": without a stream."""
        states: dict[str, int] = {}
        for session in dict(self.sessions).values():
            name = "detached" if session.stream is None else session.state.name.lower()
            states[name] = states.get(name, 0) + 1
        return states

    def take_released(self) -> list[str]:
        """Sessions let go since the last call, and not held again."""
        released, self._released = self._released, []
        return [name for name in released if name not in self.sessions]

    @property
    def committing(self) -> bool:
        return any(session.log.waiting for session in self.sessions.values())

    # -- messages -----------------------------------------------------------------------------------------------

    def handle(self, message: Any) -> None:
        match message:
            case Open():
                self._open(message)
            case Request():
                self._request(message)
            case Close(stream):
                self.closed.discard(stream)
                self._detach(stream)
            case Forget(session_id):
                self._drop(session_id)
            case HandOver(stream):
                self._hand_over(stream)
            case DrainAll():
                pass

    def _open(self, message: Open) -> None:
        if message.stream in self.closed:
            return
        try:
            request = read_hello(pb.Hello.FromString(message.hello), self.engine.codec_version)
            session = self._take_over(request)
        except RefusedError as refusal:
            self._refuse(message.stream, refusal.message)
        except FinishedError:
            detail = "the session has ended and is read-only"
            self._refuse(message.stream, pb.Refused(reason=pb.REFUSED_REASON_FINISHED, detail=detail))
        except StoreError as error:
            detail = f"store: {error}"[:200]
            refusal = pb.Refused(reason=pb.REFUSED_REASON_STORE, detail=detail, retry_after_ms=STORE_RETRY_MS)
            self._refuse(message.stream, refusal)
        except Exception:
            _log.exception("session cannot be opened", extra={"fields": {"session": message.session_id}})
            self._drop(message.session_id)
            self._send(Abort(message.stream, "INTERNAL", "the session cannot be opened: see the service's log"))
        else:
            self._attach(session, message.stream)

    def _refuse(self, stream: int, refused: pb.Refused) -> None:
        reason = pb.RefusedReason.Name(refused.reason).removeprefix("REFUSED_REASON_").lower()
        self.tally.count("refused", reason)
        _log.warning("refused", extra={"fields": {"reason": reason, "detail": refused.detail}})
        self._send(Reply(stream, pb.StreamResponse(refused=refused).SerializeToString(), last=True))

    def _take_over(self, request: SessionRequest) -> Session:
        if self._committer.away:  # one robot's Hello must not make the others wait
            raise StoreError("commits are being tried again")
        if self._quotas.any:
            self._quotas.refresh()
            self._quotas.check(request.opening.site_id)
        held = self.sessions.get(request.session_id)
        if held is not None:
            if held.stream is not None:
                self._abort(held, "ABORTED", "another stream has opened the session")
            try:
                held.log.flush()
            except (FencedError, StoreError):
                if not held.log.broken:
                    raise
                self._drop(request.session_id)
                held = None
        try:
            opened = self.store.open_session(request.opening)
        except FinishedError:
            self._drop(request.session_id)
            raise
        if held is not None and held.take_over(request, opened):
            return held
        self._drop(request.session_id)
        log = self._committer.log(opened.key, opened.epoch, opened.last_seq)
        accounts = SessionAccounts(opened.statistics, self._own_cpu_ns)
        session = Session(request, log, self.engine, self.store, self.tally, accounts)
        self.sessions[request.session_id] = session
        return session

    def _own_cpu_ns(self) -> int:
        return time.process_time_ns() + self.engine.pool_cpu_ns()

    def _attach(self, session: Session, stream: int) -> None:
        name = session.request.session_id
        session.stream, session.touched_s = stream, time.monotonic()
        self.streams[stream] = name
        self._send(Reply(stream, pb.StreamResponse(welcome=session.welcome()).SerializeToString()))
        if self.config.advice.max_kbps:
            advice = pb.Advice(max_kbps=self.config.advice.max_kbps)
            self._send(Reply(stream, pb.StreamResponse(advice=advice).SerializeToString()))
        fields = {"session": name, "epoch": session.log.epoch, "durable_seq": session.log.durable_seq}
        _log.info("session open", extra={"fields": fields})

    def _request(self, message: Request) -> None:
        session = self.sessions.get(self.streams.get(message.stream, ""))
        if session is None:  # its stream was ended from this side; the robot resumes
            return
        session.accounts.note_front(message.front_cpu_ns)
        try:
            request = pb.StreamRequest.FromString(message.body)
        except WireError:
            self._abort(session, "INVALID_ARGUMENT", "not a StreamRequest")
            return
        kind = request.WhichOneof("message")
        if kind == "report":
            session.accounts.note_edge(request.report)
        elif kind not in ("frame", "bye") or session.finishing:
            after = "Bye" if session.finishing else "Hello"
            self._abort(session, "INVALID_ARGUMENT", f"{kind or 'an empty message'} after {after}")
        elif session.held or (kind == "frame" and session.log.full):
            self._hold(session, request)
        else:
            self._take(session, request)

    def _hold(self, session: Session, request: pb.StreamRequest) -> None:
        """Unanswered, and so without credit for more: the robot keeps what comes after the window."""
        if not session.held:
            fields = {"session": session.request.session_id, "durable_seq": session.log.durable_seq}
            _log.warning("waiting for the store", extra={"fields": fields})
        session.held.append(request)
        if len(session.held) > self.config.limits.window_frames + 1:  # and a Bye
            self._abort(session, "INVALID_ARGUMENT", "more than the window allows")

    def _take(self, session: Session, request: pb.StreamRequest) -> None:
        try:
            if request.HasField("frame"):
                self._frame(session, request.frame)
            else:
                self._bye(session, request.bye)
        except SequenceGapError as gap:
            self._abort(session, "ABORTED", str(gap))
        except FencedError as error:
            self._fenced(session, error)
        except StoreError as error:
            self._store_failed(session, error)

    def _frame(self, session: Session, frame: pb.Frame) -> None:
        name = session.request.session_id
        try:
            answer = session.apply(frame, poisoned=self._poison.get(name) == frame.seq)
        except SequenceGapError:
            raise
        except StoreError as error:
            self._store_failed(session, error)
            if frame.seq > session.log.applied_seq:  # it failed half way through the pipeline, looking for a cloud
                self._drop(name)
            return
        except Exception:
            # The pipeline's state cannot be trusted any more. The robot resumes from the store and sends the
            # frame again; if it fails a second time it is rejected.
            _log.exception("frame failed", extra={"fields": {"session": name, "seq": frame.seq}})
            self.tally.count("frames", "failed")
            self._poison[name] = frame.seq
            self._abort(session, "INTERNAL", f"frame {frame.seq} failed: see the service's log")
            self._drop(name)
            return
        if self._poison.get(name) == frame.seq:
            del self._poison[name]
        assert session.stream is not None
        self._send(Reply(session.stream, pb.StreamResponse(odometry=answer).SerializeToString(), answer=True))
        if _log.isEnabledFor(logging.DEBUG):
            trace = frame.trace_id or trace_id(session.request.opening.run_id, frame.seq)
            fields = {"session": name, "seq": frame.seq, "trace_id": trace, "bytes": len(frame.payload)}
            fields |= {"state": session.state.name.lower(), "keyframe": answer.keyframe, "rejected": answer.rejected}
            _log.debug("frame", extra={"fields": fields})

    def _bye(self, session: Session, bye: pb.Bye) -> None:
        if bye.last_seq != session.log.applied_seq:
            raise SequenceGapError(session.log.applied_seq + 1, bye.last_seq + 1)
        session.finish()

    def _say_finished(self, session: Session) -> None:
        """Once the last commit is durable; a store that cannot be read just now is asked again."""
        try:
            row = Catalog(self.store).session(session.request.session_id)
        except StoreError:
            return
        if row is None:
            raise FencedError("the session was deleted")
        if session.stream is not None:
            finished = pb.Finished(
                mapped=row.frames, keyframes=row.keyframes, loops=row.loops, gnss_factors=row.gnss_factors
            )
            self._send(Reply(session.stream, pb.StreamResponse(finished=finished).SerializeToString(), last=True))
        self._poison.pop(row.session_id, None)
        _log.info("session finished", extra={"fields": {"session": row.session_id, "mapped": row.frames}})
        self._drop(session.request.session_id)

    # -- care ---------------------------------------------------------------------------------------------------

    def look_after(self) -> None:
        """After every message and while idle: commits and what became of them, sessions nobody came back to."""
        for session in list(self.sessions.values()):
            try:
                session.log.collect()
                if session.finishing:
                    if not session.log.waiting:
                        self._say_finished(session)
                    continue
                if session.stream in self._leaving and not session.log.waiting:
                    self._handed(session)
                if session.commit_due:
                    session.commit()
                while session.held and session.stream is not None and not session.log.full:
                    self._take(session, session.held.popleft())
            except FencedError as error:
                self._fenced(session, error)
            except StoreError as error:
                self._store_failed(session, error)
            except Exception:  # this session's error must not end the others'
                _log.exception("commit failed", extra={"fields": {"session": session.request.session_id}})
                self._abort(session, "INTERNAL", "the session cannot be committed: see the service's log")
                self._drop(session.request.session_id)
        self._keep_quotas()
        self._evict()

    def _keep_quotas(self) -> None:
        """Sites that have reached their quota: what is applied is committed, then their robots keep what comes."""
        if not self._quotas.looked(self._committer.run):
            return
        for session in list(self.sessions.values()):
            if session.stream is None or session.finishing:
                continue
            try:
                self._quotas.check(session.request.opening.site_id)
            except RefusedError as refusal:
                session.commit()
                stream = session.stream
                self._detach(stream)
                self._refuse(stream, refusal.message)

    def _evict(self) -> None:
        limits, now_s = self.config.limits, time.monotonic()
        detached = sorted((s for s in self.sessions.values() if s.stream is None), key=lambda s: s.touched_s)
        for position, session in enumerate(detached):
            too_many = len(detached) - position > limits.held_sessions
            done = session.log.durable_seq == session.log.applied_seq and not session.log.waiting
            if (too_many or now_s - session.touched_s > limits.idle_s) and done:
                self._drop(session.request.session_id)

    def _fenced(self, session: Session, error: Exception) -> None:
        self.tally.count("fenced")
        _log.warning("fenced", extra={"fields": {"session": session.request.session_id, "detail": str(error)}})
        self._abort(session, "ABORTED", f"fenced: {error}")
        self._drop(session.request.session_id)

    def _store_failed(self, session: Session, error: Exception) -> None:
        """It could not be read: the robot comes again. Only a session with a commit that is lost is let go."""
        _log.error("store failed", extra={"fields": {"session": session.request.session_id, "detail": str(error)}})
        self._abort(session, "UNAVAILABLE", "the store does not answer")
        if session.log.broken:
            self._drop(session.request.session_id)

    def _abort(self, session: Session, status: str, detail: str) -> None:
        if session.stream is not None:
            self._send(Abort(session.stream, status, detail))
            self._detach(session.stream)

    def _detach(self, stream: int) -> None:
        self._leaving.discard(stream)
        session = self.sessions.get(self.streams.pop(stream, ""))
        if session is not None and session.stream == stream:
            session.stream, session.touched_s = None, time.monotonic()
            session.held.clear()  # not applied: the robot sends them again

    def _drop(self, session_id: str) -> None:
        session = self.sessions.pop(session_id, None)
        if session is not None:
            if session.stream is not None:
                self._detach(session.stream)
            self._released.append(session_id)

    # -- handing over -------------------------------------------------------------------------------------------

    def _hand_over(self, stream: int) -> None:
        """One session, to another replica, once it is durable. It stays in memory, should the robot come back."""
        session = self.sessions.get(self.streams.get(stream, ""))
        if session is not None:  # else its stream was ended meanwhile
            session.commit()
            self._leaving.add(stream)

    def _handed(self, session: Session) -> None:
        """Everything is durable: what the robot still sends on this stream is for the next replica."""
        if session.stream is not None:
            self._send(Handed(session.stream, session.log.durable_seq))
            self._detach(session.stream)

    def drain(self) -> None:
        """All sessions: the commits are under way together, each robot goes as soon as its own is durable."""
        self._committer.give_up_after(self.config.commit.drain_s)
        sessions = sorted(self.sessions.values(), key=lambda session: session.stream is None)
        for session in sessions:
            session.commit()
        for session in sessions:
            try:
                session.log.flush(self.config.commit.drain_s + FLUSH_S)
                if session.finishing:
                    self._say_finished(session)
                self._handed(session)
            except (FencedError, StoreError) as error:
                fields = {"session": session.request.session_id, "detail": str(error)}
                _log.error("not committed at drain", extra={"fields": fields})
