"""The robot's side of the session protocol as plain state: what to say next, and what an answer means.

No thread, no socket, no clock of its own: uplink.py calls it under its lock. docs/protocol.md is the contract.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from edge_agent.config import UplinkConfig
from edge_agent.ending import Ending
from edge_agent.metrics import EdgeMetrics
from edge_agent.outbox import Outbox
from edge_agent.pacer import Pacer
from edge_agent.recoding import Recoding
from edge_agent.spool import Spool
from edge_agent.wire import Answer, answer, state_name
from splitslam.enums import value_name
from splitslam.logs import fields
from splitslam.wire import session_pb2 as pb

_log = logging.getLogger(__name__)
_SLOW_S = 1.0  # of a round trip
_REPORT_EVERY_S = 1.0
_LOOK_S = 0.2  # until it is looked again whether the link is idle
_BUSY_S = 0.5  # a link that has not brought an answer for so long has enough to do
BACKLOG_FRAMES = 10
ENVELOPE_BYTES = 50  # HTTP/2 and gRPC around a message


@dataclass(slots=True)
class StreamState:
    """How one stream goes; times on the caller's clock. `ended`: why it is over."""

    opened_s: float
    last_message_s: float
    hello_sent: bool = False
    welcomed: bool = False
    bye_sent: bool = False
    waiting_since_s: float | None = None  # for an answer
    answered: bool = False
    ended: Ending | None = None
    retry_after_s: float = 0.0
    other_replica: bool = False


class Dialogue:
    """One session over any number of streams. `failure`: why there will be no further one."""

    def __init__(
        self, hello: pb.Hello, settings: UplinkConfig, metrics: EdgeMetrics, spool: Spool | None = None
    ) -> None:
        self.hello = hello
        self.outbox = Outbox(settings.buffer_bytes, settings.window, spool, settings.copies_bytes)
        self.stream = StreamState(0.0, 0.0)
        self.answers: list[Answer] = []
        self.first_welcome: pb.Welcome | None = None
        self.finished: pb.Finished | None = None
        self.failure: str | None = None
        self.over = False  # the failure is the session's: it will never take another frame
        self.bye: pb.Bye | None = None
        self.want_dense = False
        self.advised_kbps: int | None = None
        self.takes_dense = False  # the service that said Welcome last stores whole scans
        self.replica = ""  # where the service wants the next stream to go
        self.pause_s: float | None = None  # how long the next frame is held back; None: it is not
        self._pacer = Pacer()
        self._recoding = Recoding(hello)
        self._settings, self._metrics = settings, metrics
        metrics.kept_from(self.outbox, spool)
        if spool is not None:
            metrics.spool_error_sources.append(spool.errors)
            metrics.drop("spool_damaged", spool.recovered.damaged)
        self._dropped: dict[str, int] = {}
        self._reported: tuple[dict[str, int], int] = {}, 0
        self._report_s = float("-inf")

    # --- what to say ------------------------------------------------------------------------------------------

    def begin(self, now_s: float) -> StreamState:
        """A new stream opens."""
        self.stream = StreamState(now_s, now_s)
        return self.stream

    def take_replica(self) -> str:
        """Where to go next, for one try."""
        replica, self.replica = self.replica, ""
        return replica

    def keep(self, frame: pb.Frame, now_s: float, arrived_s: float | None = None) -> None:
        """Takes a frame into the outbox; what has to go for it is counted. arrived_s: when its scan came."""
        self.outbox.add(frame, now_s, arrived_s)
        self._count_lost()

    def _count_lost(self) -> None:
        for lost in self.outbox.lost:
            self._metrics.drop(lost.reason)
            _log.warning("frame lost", extra=fields(run_id=self.hello.run_id, seq=lost.seq, reason=lost.reason))
        self.outbox.lost.clear()

    def set_dropped(self, dropped: Mapping[str, int]) -> None:
        """What the robot has lost since the run began."""
        self._dropped = dict(dropped)

    def next_request(self, now_s: float) -> pb.StreamRequest | None:
        """Hello, then reports and frames, Bye after the last answer; None while there is nothing to say."""
        request = self._next(now_s)
        if request is not None:
            size = request.ByteSize()
            self._metrics.sent(str(request.WhichOneof("message")), size)
            self._pacer.sent(now_s, size + ENVELOPE_BYTES)
        return request

    def _next(self, now_s: float) -> pb.StreamRequest | None:
        stream = self.stream
        if not stream.hello_sent:
            stream.hello_sent = True
            return pb.StreamRequest(hello=self.hello)
        if not stream.welcomed or stream.bye_sent:
            return None
        if self.report_due(now_s):
            self._report_s, self._reported = now_s, self._owed()
            return pb.StreamRequest(report=self._report())
        frame = None if self._held_back(now_s) else self.outbox.next_frame()
        self._count_lost()  # what cannot be read from disk any more
        if frame is not None:
            if (arrived_s := self.outbox.arrived_s(frame.seq)) is not None:
                self._metrics.scan_age.observe(now_s - arrived_s)
            if _log.isEnabledFor(logging.DEBUG):
                said = {"bytes": len(frame.payload), "dense": frame.dense, "follows_seq": frame.follows_seq}
                _log.debug("frame sent", extra=fields(run_id=self.hello.run_id, seq=frame.seq, **said))
            if stream.waiting_since_s is None:
                stream.waiting_since_s = now_s
            return pb.StreamRequest(frame=self._recoding.readable(frame))
        if self.bye is not None and self.outbox.first_unanswered() is None:
            stream.bye_sent = True
            return pb.StreamRequest(bye=self.bye)
        return None

    def may_say(self, now_s: float) -> bool:
        """False: `next_request` has nothing as things are."""
        return self.outbox.unsent > 0 or self.bye is not None or self.report_due(now_s)

    def _held_back(self, now_s: float) -> bool:
        """By the limit; a run faster than the clock keeps it by the recording's time alone (edge_agent/rate.py)."""
        size = 0 if self.hello.lockstep else self.outbox.next_size()
        wait_s = self._pacer.wait_s(now_s, size + ENVELOPE_BYTES, self.limit_kbps) if size else 0.0
        self.pause_s = wait_s if wait_s > 0 else None
        return wait_s > 0

    def spare_s(self, now_s: float, size: int) -> float:
        """How long `size` bytes that are not live have to wait, or until it is worth asking again; 0: now.

        In lockstep a limit is kept by the recording's time, which says nothing of when the link is idle: after its end.
        """
        live = self.finished is None
        if live:
            stream, waiting_s = self.stream, self.stream.waiting_since_s
            answers = waiting_s is None or now_s - waiting_s < _BUSY_S
            by_recording = self.hello.lockstep and self.limit_kbps is not None
            if not stream.welcomed or stream.ended is not None or self.outbox.unsent or not answers or by_recording:
                return _LOOK_S
        return self._pacer.spare_s(now_s, size + ENVELOPE_BYTES, self.limit_kbps, live=live)

    def spare_sent(self, now_s: float, size: int) -> None:
        """Books them."""
        self._pacer.sent(now_s, size + ENVELOPE_BYTES, live=False)

    def report_due(self, now_s: float) -> bool:
        """There is a loss or a backlog to report; at most once a second, except before Bye."""
        if self._owed() == self._reported:
            return False
        return self.bye is not None or now_s - self._report_s >= _REPORT_EVERY_S

    def _owed(self) -> tuple[dict[str, int], int]:
        """What the service is told: losses, and how many frames wait beyond those that always do."""
        unsent = self.outbox.unsent
        return self._dropped, unsent if unsent > BACKLOG_FRAMES else 0

    def _report(self) -> pb.EdgeReport:
        depth, size = len(self.outbox), self.outbox.bytes
        return pb.EdgeReport(dropped_by_reason=self._dropped, spool_frames=depth, spool_bytes=size)

    def deadline(self, welcome_within_s: float) -> tuple[float, Ending]:
        """Until when the stream may go on as it is, and what it then is guilty of."""
        s, stream = self._settings, self.stream
        if not stream.welcomed:  # a replica that builds a long session again gives signs of life, a frozen one none
            late = Ending("no_welcome", f"no Welcome within {welcome_within_s:g} s")
            return stream.last_message_s + welcome_within_s, late
        silent_s = stream.last_message_s + s.watchdog_s
        silent = silent_s, Ending("silent", f"silent for {s.watchdog_s:g} s")
        if stream.waiting_since_s is None or silent_s <= stream.waiting_since_s + s.answer_timeout_s:
            return silent
        late = Ending("unanswered", f"a frame unanswered for {s.answer_timeout_s:g} s")
        return stream.waiting_since_s + s.answer_timeout_s, late

    # --- what an answer means ---------------------------------------------------------------------------------

    def receive(self, response: pb.StreamResponse, now_s: float) -> None:
        """Takes one message of the service."""
        self.stream.last_message_s = now_s
        kind = response.WhichOneof("message")
        self._metrics.received(str(kind), response.ByteSize())
        if kind == "welcome":
            self._on_welcome(response.welcome)
        elif kind == "odometry":
            self._on_odometry(response.odometry, now_s)
        elif kind == "credit":
            self.outbox.window = response.credit.window
            self.outbox.mark_durable(response.credit.durable_seq)
        elif kind == "advice":
            self._on_advice(response.advice)
        elif kind == "drain":
            self.replica = response.drain.replica
            reason = value_name(pb.DrainReason, response.drain.reason, "DRAIN_REASON_")
            self._end(Ending("drain", f"drain: {reason}"), response.drain.retry_after_ms)
        elif kind == "refused":
            self._on_refused(response.refused)
        elif kind == "finished":
            self.finished = response.finished

    def _on_welcome(self, welcome: pb.Welcome) -> None:
        if not self.outbox.rewind(welcome.applied_seq, welcome.durable_seq):
            released, durable = self.outbox.released_seq, welcome.durable_seq
            self.over = True
            self.failure = (
                f"the session was stored up to scan {released} and now ends at {durable}; expected nothing lost"
            )
            return
        self.stream.welcomed = True
        self.takes_dense = welcome.takes_dense
        self._recoding.on_welcome(welcome)
        self._reported = ({}, 0)  # counts since the run began: saying them again is no harm
        self._report_s = float("-inf")
        self._metrics.connects.inc()
        self._metrics.connected.set(1)
        self.first_welcome = self.first_welcome or welcome

    def _on_odometry(self, message: pb.Odometry, now_s: float) -> None:
        self.outbox.mark_durable(message.durable_seq)
        held = self.outbox.answer(message.seq)
        self.stream.waiting_since_s = now_s if self.outbox.in_flight else None
        if held is None:
            known = message.duplicate or self.outbox.was_answered(message.seq)
            self._metrics.ignored.inc("duplicate" if known else "unexpected")
            return
        self.stream.answered = True
        self.answers.append(answer(message, now_s - held.queued_s))
        self._note(self.answers[-1])

    def _note(self, answer: Answer) -> None:
        """Each answer at debug; a rejection, or one that was long in coming, for whoever looks after the robot."""
        reply, slow = answer.reply, answer.round_trip_s > _SLOW_S
        level = logging.WARNING if reply.rejected else logging.INFO if slow else logging.DEBUG
        if not _log.isEnabledFor(level):
            return
        event = "frame rejected" if reply.rejected else "frame slow" if slow else "frame answered"
        said: dict[str, Any] = {"round_trip_ms": round(answer.round_trip_s * 1e3, 1), "state": state_name(reply.state)}
        if reply.rejected:
            said["reason"] = reply.rejected
        _log.log(level, event, extra=fields(run_id=self.hello.run_id, seq=reply.seq, **said))

    def _on_advice(self, advice: pb.Advice) -> None:
        """max_kbps 0: no limit of the service's; an Advice that only wants a dense frame leaves the limit alone."""
        self.want_dense |= advice.want_dense
        if advice.max_kbps or not advice.want_dense:
            self.advised_kbps = advice.max_kbps or None

    @property
    def limit_kbps(self) -> float | None:
        """The configured or the advised limit of the uplink, whichever is lower."""
        limits = [limit for limit in (self._settings.max_kbps, self.advised_kbps) if limit is not None]
        return min(limits, default=None)

    def _on_refused(self, refused: pb.Refused) -> None:
        name = value_name(pb.RefusedReason, refused.reason, "REFUSED_REASON_")
        if refused.reason == pb.REFUSED_REASON_FINISHED and self.bye is not None:
            self.finished = pb.Finished()  # the answer to our Bye was lost with the stream before
        elif refused.retry_after_ms == 0:
            self.failure = f"the map service refused the session ({name}): {refused.detail}"
            self.over = refused.reason == pb.REFUSED_REASON_FINISHED
        else:
            self._end(Ending("refused", f"refused ({name}): {refused.detail}"), refused.retry_after_ms)

    def _end(self, ending: Ending, retry_after_ms: int) -> None:
        self.stream.ended = ending
        self.stream.retry_after_s = retry_after_ms * 1e-3
        self.stream.other_replica = True
