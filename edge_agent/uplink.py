"""The robot's end of the session protocol behind a small synchronous interface.

`send` never blocks; one supervising thread opens streams, watches them and opens the next when one breaks. Frames
stay in the outbox until they are durable and answered, so a break costs time but no frame.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping

from edge_agent.backoff import Backoff, jittered, welcome_timeout_s
from edge_agent.config import UplinkConfig, split_server
from edge_agent.dialogue import BACKLOG_FRAMES, Dialogue, StreamState
from edge_agent.ending import Ending
from edge_agent.metrics import EdgeMetrics
from edge_agent.spool import Spool
from edge_agent.stream import Stream
from edge_agent.tcp_meter import TcpBytes, TcpMeter
from edge_agent.wire import Answer
from splitslam.errors import InputError
from splitslam.logs import fields
from splitslam.security.client import Connector
from splitslam.security.settings import ClientTls
from splitslam.wire import session_pb2 as pb

_log = logging.getLogger(__name__)
_STEADY_S = 1.0  # a stream that lived so long, or answered, was worth having: the next failure starts over
_TELL_S = 10.0  # without a service from the start, before that is said
_LOOK_S = 0.2  # while frames of a run before go first


class SessionOverError(InputError):
    """The session will never take another frame: it was finished, or the service has lost what it had stored.

    The next start begins a new run, so it is worth starting again, which exit code 2 would not say.
    """

    exit_code = 75  # EX_TEMPFAIL of sysexits.h


class Uplink:
    """One session (robot_id, run_id). Every method may be called from any thread.

    Methods that wait raise InputError when the service stays unreachable, refuses for good, or has lost what it
    had called durable.
    """

    def __init__(
        self,
        server: str,
        hello: pb.Hello,
        settings: UplinkConfig,
        metrics: EdgeMetrics,
        spool: Spool | None = None,
        shared: Callable[[], bool] = lambda: False,
        tls: ClientTls | None = None,
    ) -> None:
        """Raises InputError for certificates that cannot be used.

        spool: the run's, with what an agent before has left in it. shared: whether others use the link as well.
        tls: None: none, which only a server on this machine allows.
        """
        self._server, self._settings, self._metrics, self._shared = server, settings, metrics, shared
        self._connector = Connector(server, tls or ClientTls())
        self._dialogue = Dialogue(hello, settings, metrics, spool)
        self._resumes = len(self._dialogue.outbox) > 0
        self._meter = TcpMeter(*split_server(server))
        lock = (
            threading.RLock()
        )  # guards the dialogue and all below; waking a thread for nothing costs as much as a call
        self._changed = threading.Condition(lock)  # for callers: an answer, or the end
        self._to_say = threading.Condition(lock)  # for the stream's sender
        self._broken = threading.Condition(lock)  # for the supervisor
        self._stream: Stream | None = None
        self._failure: Exception | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._supervise, name="uplink", daemon=True)
        metrics.tcp_bytes_from(lambda: self.tcp_bytes().sent, lambda: self.tcp_bytes().received)

    # --- the synchronous side ---------------------------------------------------------------------------------

    def start(self) -> None:
        """Begins to connect; returns at once."""
        self._thread.start()

    def wait_welcome(self) -> pb.Welcome | None:
        """Waits for the first Welcome; None when stopped meanwhile."""
        with self._changed:
            self._changed.wait_for(lambda: self._dialogue.first_welcome or self._over)
            self._raise_failure()
            return self._dialogue.first_welcome

    @property
    def welcome(self) -> pb.Welcome | None:
        """The first Welcome, if it has come."""
        with self._changed:
            return self._dialogue.first_welcome

    @property
    def all_on_disk(self) -> bool:
        """Whether every frame that is kept would survive the end of this process."""
        with self._changed:
            return self._dialogue.outbox.all_on_disk

    @property
    def kept(self) -> int:
        """Frames that are not yet durable and answered."""
        with self._changed:
            return len(self._dialogue.outbox)

    def send(self, frame: pb.Frame, arrived_s: float | None = None) -> None:
        """Queues a frame (seq above all before). A full buffer drops the oldest that is not dense, and counts it.

        arrived_s: when its scan came, on the system's monotonic clock; None: not known.
        """
        with self._changed:
            self._raise_failure()
            self._dialogue.keep(frame, time.monotonic(), arrived_s)
            self._to_say.notify_all()

    def take_answers(self) -> list[Answer]:
        """Answers since the last call, in the order they came; each frame's first answer only."""
        with self._changed:
            self._raise_failure()
            answers, self._dialogue.answers = self._dialogue.answers, []
            return answers

    def wait_answers(self, timeout_s: float) -> list[Answer]:
        """The same, once there is one or so much time has passed."""
        with self._changed:
            self._changed.wait_for(lambda: self._dialogue.answers or self._over, timeout_s)
        return self.take_answers()

    def take_want_dense(self) -> bool:
        """Whether the service has asked for a dense frame since the last call."""
        with self._changed:
            wanted, self._dialogue.want_dense = self._dialogue.want_dense, False
            return wanted

    @property
    def limit_kbps(self) -> float | None:
        """What the uplink may take, by the configuration and the service's advice."""
        with self._changed:
            return self._dialogue.limit_kbps

    @property
    def takes_dense(self) -> bool:
        """Whether the service stores whole scans of keyframes, as far as it has told."""
        with self._changed:
            return self._dialogue.takes_dense

    def spare_s(self, size: int) -> float:
        """How long `size` bytes that are not live have to wait, or until it is worth asking again; 0: now."""
        with self._changed:
            return _LOOK_S if self._shared() else self._dialogue.spare_s(time.monotonic(), size)

    def spare_sent(self, size: int) -> None:
        """They go now; on another connection."""
        with self._changed:
            self._dialogue.spare_sent(time.monotonic(), size)

    @property
    def backlog(self) -> bool:
        """Whether frames of an outage still wait to be sent, this run's or another's."""
        with self._changed:
            return self._dialogue.outbox.unsent > BACKLOG_FRAMES or self._shared()

    def wait_answered(self, seq: int) -> bool:
        """Waits until no frame up to `seq` lacks its answer; False when stopped meanwhile."""
        with self._changed:
            self._changed.wait_for(lambda: self._settled(seq) or self._over)
            self._raise_failure()
            return self._settled(seq)

    def _settled(self, seq: int) -> bool:
        first = self._dialogue.outbox.first_unanswered()
        return first is None or first > seq

    def report_drops(self, dropped: Mapping[str, int]) -> None:
        """Tells the service what the robot has lost; at most once a second, the last before Bye."""
        with self._changed:
            self._dialogue.set_dropped(dropped)
            if self._dialogue.report_due(time.monotonic()):
                self._to_say.notify_all()

    def finish(self, last_seq: int) -> pb.Finished | None:
        """Says Bye once every frame is answered and waits for Finished; None when stopped meanwhile."""
        with self._changed:
            self._dialogue.bye = pb.Bye(last_seq=last_seq)
            self._to_say.notify_all()
            self._changed.wait_for(lambda: self._dialogue.finished or self._over)
            self._raise_failure()
            return self._dialogue.finished

    def stop(self) -> None:
        """Whoever waits goes on at once, and the stream ends."""
        with self._changed:
            self._closing = True
            self._tell_all()

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
            dialogue = self._dialogue
            return self._stream is not None and dialogue.stream.welcomed and dialogue.outbox.unsent <= 1

    def certificate_expires_s(self) -> float:
        """Unix time of the first certificate to expire, s; NaN without TLS."""
        return self._connector.expires_s

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
                self._tell_all()

    def _keep_connected(self) -> None:
        s = self._settings
        backoff = Backoff(s.backoff_first_s, s.backoff_max_s)
        failures, told = 0, False
        down_since_s = time.monotonic()
        while True:
            state = self._one_stream(welcome_timeout_s(s.welcome_timeout_s, s.welcome_timeout_max_s, failures))
            now_s = time.monotonic()
            failures = 0 if state.welcomed else failures + 1
            if state.answered or (state.welcomed and now_s - state.opened_s >= _STEADY_S):
                backoff.reset()
                down_since_s = now_s
            with self._changed:
                if self._over or self._dialogue.finished is not None:
                    return
                first = self._dialogue.first_welcome is None and not self._resumes
                limit_s = s.connect_timeout_s if first else s.reconnect_timeout_s
                if limit_s is not None and now_s - down_since_s >= limit_s:
                    self._fail(f"expected a map service there, none answered within {limit_s:g} s ({state.ended})")
                    return
                cause = state.ended.cause if state.ended else "unknown"
                self._metrics.reconnects.inc(cause)
                run_id = self._dialogue.hello.run_id
                said = fields(run_id=run_id, server=self._server, cause=cause, detail=str(state.ended))
                _log.info("stream broke", extra=said)
                if first and not told and now_s - down_since_s >= _TELL_S:
                    told = True
                    _log.warning("no map service yet: frames are kept until it answers", extra=said)
                if state.other_replica or not state.welcomed:
                    self._dialogue.hello.attempt += 1
                delay_s = max(backoff.next_s(), jittered(state.retry_after_s))
                self._broken.wait_for(lambda: self._closing, timeout=delay_s)

    def _one_stream(self, welcome_within_s: float) -> StreamState:
        """Runs one stream to its end."""
        with self._changed:
            state = self._dialogue.begin(time.monotonic())
            callbacks = (self._next_request, self._on_response, self._on_end)
            hello, replica = self._dialogue.hello, self._dialogue.take_replica()
            stream = self._stream = Stream(self._connector, hello, replica, *callbacks)
            while state.ended is None and not self._over and self._dialogue.finished is None:
                deadline_s, ending = self._dialogue.deadline(welcome_within_s)
                if (left_s := deadline_s - time.monotonic()) <= 0:
                    state.ended, state.other_replica = ending, True
                    break
                # a frame that is sent meanwhile may set a nearer deadline, but none before this
                self._broken.wait(min(left_s, self._settings.answer_timeout_s))
            if not state.other_replica:  # a link that broke: the replica may still hold the session in memory
                self._dialogue.replica = stream.replica
            self._metrics.connected.set(0)
            self._stream = None  # from here on its callbacks find themselves outdated
            self._tell_all()
        self._meter.discover()
        stream.close()
        return state

    def _fail(self, text: str) -> None:
        kind = SessionOverError if self._dialogue.over else InputError
        self._failure = kind(f"server {self._server}: {text}")
        self._tell_all()

    def _tell_all(self) -> None:
        for waiting in (self._changed, self._to_say, self._broken):
            waiting.notify_all()

    # --- called by the stream's threads -----------------------------------------------------------------------

    def _next_request(self, stream: Stream) -> pb.StreamRequest | None:
        with self._changed:
            while self._stream is stream:
                kept = len(self._dialogue.outbox)
                request = self._dialogue.next_request(time.monotonic())
                if len(self._dialogue.outbox) < kept:  # a frame that cannot be read any more: nobody need wait for it
                    self._changed.notify_all()
                if request is not None:
                    return request
                self._to_say.wait(self._dialogue.pause_s)
            return None

    def _on_response(self, stream: Stream, response: pb.StreamResponse) -> None:
        if response.HasField("welcome"):
            self._meter.discover()  # before the lock: it may ask the resolver
        with self._changed:
            if self._stream is not stream:
                return
            dialogue, now_s = self._dialogue, time.monotonic()
            dialogue.receive(response, now_s)
            if dialogue.failure is not None:
                self._fail(dialogue.failure)
            self._changed.notify_all()
            if dialogue.may_say(now_s):
                self._to_say.notify_all()
            if dialogue.stream.ended is not None or dialogue.finished is not None:
                self._broken.notify_all()

    def _on_end(self, stream: Stream, ending: Ending) -> None:
        with self._changed:
            if self._stream is stream and self._dialogue.stream.ended is None:
                self._dialogue.stream.ended = ending
                self._broken.notify_all()
