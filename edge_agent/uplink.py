"""The robot's end of the session protocol behind a small synchronous interface.

`send` never blocks; one supervising thread opens streams, watches them and opens the next when one breaks. Frames
stay in the outbox until they are durable and answered, so a break costs time but no frame.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass

from edge_agent.backoff import Backoff, welcome_timeout_s
from edge_agent.config import UplinkConfig, split_server
from edge_agent.metrics import EdgeMetrics
from edge_agent.outbox import Outbox
from edge_agent.stream import Stream
from edge_agent.tcp_meter import TcpBytes, TcpMeter
from edge_agent.wire import Answer, answer
from splitslam.errors import InputError
from splitslam.wire import session_pb2 as pb

_log = logging.getLogger(__name__)
_STEADY_S = 1.0  # a stream that lived so long, or answered, was worth having: the next failure starts over
_REPORT_EVERY_S = 1.0


@dataclass(slots=True)
class _Watch:
    """The present stream as the supervisor sees it; times are time.monotonic()."""

    opened_s: float
    last_message_s: float
    hello_sent: bool = False
    welcomed: bool = False
    bye_sent: bool = False
    waiting_since_s: float | None = None  # for an answer
    answered: bool = False
    ended: str | None = None
    retry_after_s: float | None = None
    other_replica: bool = False


class Uplink:
    """One session (robot_id, run_id). Every method may be called from any thread.

    Methods that wait raise InputError when the service stays unreachable, refuses for good, or has lost what it
    had called durable.
    """

    def __init__(self, server: str, hello: pb.Hello, settings: UplinkConfig, metrics: EdgeMetrics) -> None:
        self._server, self._hello, self._settings, self._metrics = server, hello, settings, metrics
        self._outbox = Outbox(settings.buffer_bytes, settings.window)
        self._meter = TcpMeter(*split_server(server))
        self._changed = threading.Condition()
        self._stream: Stream | None = None
        self._watch = _Watch(0.0, 0.0)
        self._answers: list[Answer] = []
        self._failure: Exception | None = None
        self._closing = False
        self._bye: pb.Bye | None = None
        self._dropped: dict[str, int] = {}
        self._reported: dict[str, int] = {}
        self._report_s = float("-inf")
        self.first_welcome: pb.Welcome | None = None
        self.finished: pb.Finished | None = None
        self.advice = pb.Advice()
        self._thread = threading.Thread(target=self._supervise, name="uplink", daemon=True)
        metrics.tcp_bytes_from(lambda: self.tcp_bytes().sent, lambda: self.tcp_bytes().received)

    # --- the synchronous side ---------------------------------------------------------------------------------

    def start(self) -> None:
        """Begins to connect; returns at once."""
        self._thread.start()

    def wait_welcome(self) -> pb.Welcome | None:
        """Waits for the first Welcome; None when closed meanwhile."""
        with self._changed:
            self._changed.wait_for(lambda: self.first_welcome or self._over)
            self._raise_failure()
            return self.first_welcome

    def send(self, frame: pb.Frame) -> None:
        """Queues a frame (seq above all before). A full buffer drops the oldest that is not dense, and counts it."""
        with self._changed:
            self._raise_failure()
            for lost in self._outbox.add(frame, time.monotonic()):
                self._metrics.drop("buffer_full_after_answer" if lost.answered else "buffer_full")
            self._gauge()
            self._changed.notify_all()

    def take_answers(self) -> list[Answer]:
        """Answers since the last call, in the order they came; each frame's first answer only."""
        with self._changed:
            self._raise_failure()
            answers, self._answers = self._answers, []
            return answers

    def wait_answered(self, seq: int) -> bool:
        """Waits until no frame up to `seq` lacks its answer; False when closed meanwhile."""
        with self._changed:
            self._changed.wait_for(lambda: self._settled(seq) or self._over)
            self._raise_failure()
            return self._settled(seq)

    def _settled(self, seq: int) -> bool:
        first = self._outbox.first_unanswered()
        return first is None or first > seq

    def report_drops(self, dropped: Mapping[str, int]) -> None:
        """Tells the service what the robot has lost; at most once a second, the last before Bye."""
        with self._changed:
            self._dropped = dict(dropped)
            if self._report_due():
                self._changed.notify_all()

    def finish(self, last_seq: int) -> pb.Finished | None:
        """Says Bye once every frame is answered and waits for Finished; None when closed meanwhile."""
        with self._changed:
            self._bye = pb.Bye(last_seq=last_seq)
            self._changed.notify_all()
            self._changed.wait_for(lambda: self.finished or self._over)
            self._raise_failure()
            return self.finished

    def stop(self) -> None:
        """Whoever waits goes on at once, and the stream ends."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()

    def close(self) -> None:
        """Ends the stream, without Bye unless `finish` was called: the session can be resumed."""
        self.stop()
        if self._thread.is_alive():
            self._thread.join()
        self._meter.settle()

    @property
    def anchored(self) -> bool:
        """The service follows the robot now: connected, nothing left to replay."""
        with self._changed:
            return self._stream is not None and self._watch.welcomed and self._outbox.unsent <= 1

    def tcp_bytes(self) -> TcpBytes:
        """TCP payload so far, all connections."""
        return self._meter.read()

    @property
    def _over(self) -> bool:
        return self._closing or self._failure is not None

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    # --- the supervisor ---------------------------------------------------------------------------------------

    def _supervise(self) -> None:
        try:
            self._keep_connected()
        except Exception as error:  # a defect: whoever waits must hear of it
            with self._changed:
                self._failure = error
                self._changed.notify_all()

    def _keep_connected(self) -> None:
        s = self._settings
        backoff = Backoff(s.backoff_first_s, s.backoff_max_s)
        failures = 0
        down_since_s = time.monotonic()
        while True:
            watch = self._one_stream(welcome_timeout_s(s.welcome_timeout_s, s.welcome_timeout_max_s, failures))
            now_s = time.monotonic()
            failures = 0 if watch.welcomed else failures + 1
            if watch.answered or (watch.welcomed and now_s - watch.opened_s >= _STEADY_S):
                backoff.reset()
                down_since_s = now_s
            with self._changed:
                if self._over or self.finished is not None:
                    return
                limit_s = s.connect_timeout_s if self.first_welcome is None else s.reconnect_timeout_s
                if limit_s is not None and now_s - down_since_s >= limit_s:
                    self._fail(f"expected a map service there, none answered within {limit_s:g} s ({watch.ended})")
                    return
                self._metrics.reconnects.labels(_cause(watch)).inc()
                _log.info("stream to %s broke: %s", self._server, watch.ended)
                delay_s = max(backoff.next_s(), watch.retry_after_s or 0.0)
                if watch.other_replica or not watch.welcomed:
                    self._hello.attempt += 1
                self._changed.wait_for(lambda: self._closing, timeout=delay_s)

    def _one_stream(self, welcome_within_s: float) -> _Watch:
        """Runs one stream to its end."""
        now_s = time.monotonic()
        watch = _Watch(now_s, now_s)
        with self._changed:
            self._watch = watch
            hello = pb.Hello()
            hello.CopyFrom(self._hello)
            callbacks = (self._next_request, self._on_response, self._on_end)
            stream = self._stream = Stream(self._server, hello, *callbacks)
            while watch.ended is None and not self._over and self.finished is None:
                deadline_s, reason = self._deadline(watch, welcome_within_s)
                if (left_s := deadline_s - time.monotonic()) <= 0:
                    watch.ended, watch.other_replica = reason, True
                    break
                self._changed.wait(left_s)
            self._stream = None  # from here on its callbacks find themselves outdated
            self._changed.notify_all()
        self._meter.discover()
        stream.close()
        return watch

    def _deadline(self, watch: _Watch, welcome_within_s: float) -> tuple[float, str]:
        s = self._settings
        if not watch.welcomed:
            return watch.opened_s + welcome_within_s, f"no Welcome within {welcome_within_s:g} s"
        deadline = (watch.last_message_s + s.watchdog_s, f"silent for {s.watchdog_s:g} s")
        if watch.waiting_since_s is not None:
            late = (watch.waiting_since_s + s.answer_timeout_s, f"a frame unanswered for {s.answer_timeout_s:g} s")
            deadline = min(deadline, late)
        return deadline

    def _fail(self, text: str) -> None:
        self._failure = InputError(f"server {self._server}: {text}")
        self._changed.notify_all()

    # --- called by the stream's threads -----------------------------------------------------------------------

    def _next_request(self, stream: Stream) -> pb.StreamRequest | None:
        with self._changed:
            request = self._pending(stream)
            while request is None and self._stream is stream:
                self._changed.wait()
                request = self._pending(stream)
            if self._stream is not stream or request is None:
                return None
            self._metrics.sent(str(request.WhichOneof("message")), request.ByteSize())
            return request

    def _pending(self, stream: Stream) -> pb.StreamRequest | None:
        """What goes next: Hello, then reports and frames, Bye after the last answer."""
        if self._stream is not stream:
            return None
        if not self._watch.hello_sent:
            self._watch.hello_sent = True
            return pb.StreamRequest(hello=stream.hello)
        if not self._watch.welcomed or self._watch.bye_sent:
            return None
        if self._report_due():
            self._report_s, self._reported = time.monotonic(), self._dropped
            return pb.StreamRequest(report=self._report())
        if (frame := self._outbox.next_frame()) is not None:
            if self._watch.waiting_since_s is None:
                self._watch.waiting_since_s = time.monotonic()
                self._changed.notify_all()  # the supervisor has a nearer deadline now
            return pb.StreamRequest(frame=frame)
        if self._bye is not None and self._outbox.first_unanswered() is None:
            self._watch.bye_sent = True
            return pb.StreamRequest(bye=self._bye)
        return None

    def _report_due(self) -> bool:
        if self._dropped == self._reported:
            return False
        return self._bye is not None or time.monotonic() - self._report_s >= _REPORT_EVERY_S

    def _report(self) -> pb.EdgeReport:
        depth, size = len(self._outbox), self._outbox.bytes
        return pb.EdgeReport(dropped_by_reason=self._dropped, spool_frames=depth, spool_bytes=size)

    def _on_response(self, stream: Stream, response: pb.StreamResponse) -> None:
        kind = response.WhichOneof("message")
        if kind == "welcome":
            self._meter.discover()  # before the lock: it may ask the resolver
        with self._changed:
            if self._stream is not stream:
                return
            self._watch.last_message_s = time.monotonic()
            if kind == "welcome":
                self._on_welcome(response.welcome)
            elif kind == "odometry":
                self._on_odometry(response.odometry)
            elif kind == "credit":
                self._outbox.window = response.credit.window
                self._outbox.mark_durable(response.credit.durable_seq)
            elif kind == "advice":
                self.advice = response.advice
            elif kind == "drain":
                self._end(f"drain: {pb.DrainReason.Name(response.drain.reason)}", response.drain.retry_after_ms)
            elif kind == "refused":
                self._on_refused(response.refused)
            elif kind == "finished":
                self.finished = response.finished
            self._gauge()
            self._changed.notify_all()

    def _on_welcome(self, welcome: pb.Welcome) -> None:
        if not self._outbox.rewind(welcome.applied_seq, welcome.durable_seq):
            released, durable = self._outbox.released_seq, welcome.durable_seq
            self._fail(f"the session was stored up to scan {released} and now ends at {durable}; expected nothing lost")
            return
        self._watch.welcomed = True
        self._reported, self._report_s = {}, float("-inf")  # counts since the run began: saying them again does no harm
        self._metrics.connects.inc()
        self.first_welcome = self.first_welcome or welcome

    def _on_odometry(self, message: pb.Odometry) -> None:
        watch, now_s = self._watch, time.monotonic()
        self._outbox.mark_durable(message.durable_seq)
        held = self._outbox.answer(message.seq)
        watch.waiting_since_s = now_s if self._outbox.in_flight else None
        if held is None:
            known = message.duplicate or self._outbox.was_answered(message.seq)
            self._metrics.ignored.labels("duplicate" if known else "unexpected").inc()
            return
        watch.answered = True
        self._answers.append(answer(message, now_s - held.queued_s))

    def _on_refused(self, refused: pb.Refused) -> None:
        name = pb.RefusedReason.Name(refused.reason).removeprefix("REFUSED_REASON_").lower()
        if refused.reason == pb.REFUSED_REASON_FINISHED and self._bye is not None:
            self.finished = pb.Finished()  # the answer to our Bye was lost with the stream before
        elif refused.retry_after_ms == 0:
            self._fail(f"the map service refused the session ({name}): {refused.detail}")
        else:
            self._end(f"refused ({name}): {refused.detail}", refused.retry_after_ms)

    def _end(self, reason: str, retry_after_ms: int) -> None:
        self._watch.ended = reason
        self._watch.retry_after_s = retry_after_ms * 1e-3
        self._watch.other_replica = True

    def _on_end(self, stream: Stream, reason: str) -> None:
        with self._changed:
            if self._stream is stream and self._watch.ended is None:
                self._watch.ended = reason
                self._changed.notify_all()

    def _gauge(self) -> None:
        self._metrics.buffer_frames.set(len(self._outbox))
        self._metrics.buffer_bytes.set(self._outbox.bytes)


def _cause(watch: _Watch) -> str:
    return (watch.ended or "closed").split(":")[0].split(" (")[0][:40]
