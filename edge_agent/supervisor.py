"""What keeps a session connected: a thread that opens streams, watches them and opens the next when one breaks."""

from __future__ import annotations

import logging
import threading
import time

from edge_agent.backoff import Backoff, jittered, welcome_timeout_s
from edge_agent.config import UplinkConfig
from edge_agent.dialogue import StreamState
from edge_agent.ending import Ending
from edge_agent.metrics import EdgeMetrics
from edge_agent.shared_dialogue import SharedDialogue
from edge_agent.stream import Stream
from edge_agent.tcp_meter import TcpMeter
from splitslam.errors import InputError
from splitslam.logs import fields
from splitslam.security.client import Connector
from splitslam.wire import session_pb2 as pb

_log = logging.getLogger(__name__)
_STEADY_S = 1.0  # a stream that lived so long, or answered, was worth having: the next failure starts over
_TELL_S = 5.0  # without a service, before that is said


class SessionOverError(InputError):
    """The session will never take another frame: it was finished, or the service has lost what it had stored.

    The next start begins a new run, so it is worth starting again, which exit code 2 would not say.
    """

    exit_code = 75  # EX_TEMPFAIL of sysexits.h


class Supervisor:
    """Ends by itself when the session is finished, has failed for good, or is closed."""

    def __init__(
        self,
        server: str,
        connector: Connector,
        settings: UplinkConfig,
        metrics: EdgeMetrics,
        meter: TcpMeter,
        shared: SharedDialogue,
    ) -> None:
        """meter: is told of each connection."""
        self._server, self._connector, self._settings, self._metrics = server, connector, settings, metrics
        self._meter, self._shared, self._dialogue = meter, shared, shared.dialogue
        self._resumes = len(shared.dialogue.outbox) > 0
        self._down_since_s = time.monotonic()
        self._told = False  # that it is down
        self._thread = threading.Thread(target=self._supervise, name="uplink", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def join(self) -> None:
        """Waits for its end, if it was started."""
        if self._thread.is_alive():
            self._thread.join()

    def _supervise(self) -> None:
        try:
            self._keep_connected()
        except Exception as error:  # a defect: whoever waits must hear of it
            with self._shared.lock:
                self._shared.fail(error)

    def _keep_connected(self) -> None:
        s = self._settings
        backoff = Backoff(s.backoff_first_s, s.backoff_max_s)
        failures = 0
        while True:
            state = self._one_stream(welcome_timeout_s(s.welcome_timeout_s, s.welcome_timeout_max_s, failures))
            now_s = time.monotonic()
            failures = 0 if state.welcomed else failures + 1
            if state.answered or (state.welcomed and now_s - state.opened_s >= _STEADY_S):
                backoff.reset()
                self._down_since_s = now_s
            down_s = now_s - self._down_since_s
            with self._shared.lock:
                if self._shared.over or self._dialogue.finished is not None:
                    return
                first = self._dialogue.first_welcome is None and not self._resumes
                limit_s = s.connect_timeout_s if first else s.reconnect_timeout_s
                if limit_s is not None and down_s >= limit_s:
                    self._fail(f"expected a map service there, none answered within {limit_s:g} s ({state.ended})")
                    return
                cause = state.ended.cause if state.ended else "unknown"
                self._metrics.reconnects.inc(cause)
                run_id = self._dialogue.hello.run_id
                said = fields(run_id=run_id, server=self._server, cause=cause, detail=str(state.ended))
                _log.info("stream broke", extra=said)
                if not self._told and down_s >= _TELL_S:
                    self._told = True
                    _log.warning("map service does not answer: frames are kept until it does", extra=said)
                if state.other_replica or not state.welcomed:
                    self._dialogue.hello.attempt += 1
                delay_s = max(backoff.next_s(), jittered(state.retry_after_s))
                self._shared.broken.wait_for(lambda: self._shared.closing, timeout=delay_s)

    def _one_stream(self, welcome_within_s: float) -> StreamState:
        """Runs one stream to its end."""
        with self._shared.lock:
            state = self._dialogue.begin(time.monotonic())
            callbacks = (self._next_request, self._on_response, self._on_end)
            hello, replica = self._dialogue.hello, self._dialogue.take_replica()
            stream = self._shared.stream = Stream(self._connector, hello, replica, *callbacks)
            while state.ended is None and not self._shared.over and self._dialogue.finished is None:
                deadline_s, ending = self._dialogue.deadline(welcome_within_s)
                if (left_s := deadline_s - time.monotonic()) <= 0:
                    state.ended, state.other_replica = ending, True
                    break
                # a frame that is sent meanwhile may set a nearer deadline, but none before this
                self._shared.broken.wait(min(left_s, self._settings.answer_timeout_s))
            if not state.other_replica:  # a link that broke: the replica may still hold the session in memory
                self._dialogue.replica = stream.replica
            self._metrics.connected.set(0)
            self._shared.stream = None  # from here on its callbacks find themselves outdated
            self._shared.tell_all()
        self._meter.discover()
        stream.close()
        return state

    def _fail(self, text: str) -> None:
        kind = SessionOverError if self._dialogue.over else InputError
        self._shared.fail(kind(f"server {self._server}: {text}"))

    # --- called by the stream's threads -----------------------------------------------------------------------

    def _next_request(self, stream: Stream) -> pb.StreamRequest | None:
        with self._shared.lock:
            while self._shared.stream is stream:
                kept = len(self._dialogue.outbox)
                request = self._dialogue.next_request(time.monotonic())
                if len(self._dialogue.outbox) < kept:  # a frame that cannot be read any more: nobody need wait for it
                    self._shared.changed.notify_all()
                if request is not None:
                    return request
                self._shared.to_say.wait(self._dialogue.pause_s)
            return None

    def _on_response(self, stream: Stream, response: pb.StreamResponse) -> None:
        if response.HasField("welcome"):
            self._meter.discover()  # before the lock: it may ask the resolver
        with self._shared.lock:
            if self._shared.stream is not stream:
                return
            dialogue, now_s = self._dialogue, time.monotonic()
            dialogue.receive(response, now_s)
            if self._told and dialogue.stream.welcomed:
                self._told = False
                said = fields(run_id=dialogue.hello.run_id, server=self._server, after_s=now_s - self._down_since_s)
                _log.warning("map service is there", extra=said)
            if dialogue.failure is not None:
                self._fail(dialogue.failure)
            self._shared.changed.notify_all()
            if dialogue.may_say(now_s):
                self._shared.to_say.notify_all()
            # a Welcome brings a nearer deadline than the one that is waited for
            if response.HasField("welcome") or dialogue.stream.ended is not None or dialogue.finished is not None:
                self._shared.broken.notify_all()

    def _on_end(self, stream: Stream, ending: Ending) -> None:
        with self._shared.lock:
            if self._shared.stream is stream and self._dialogue.stream.ended is None:
                self._dialogue.stream.ended = ending
                self._shared.broken.notify_all()
