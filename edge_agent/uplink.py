"""The robot's end of the session protocol behind a small synchronous interface.

`send` never blocks; a supervisor keeps the session connected. Frames stay in the outbox until they are durable and
answered, so a break costs time but no frame.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from edge_agent.config import UplinkConfig, split_server
from edge_agent.dialogue import BACKLOG_FRAMES, Dialogue
from edge_agent.metrics import EdgeMetrics
from edge_agent.shared_dialogue import SharedDialogue
from edge_agent.spool import Spool
from edge_agent.supervisor import Supervisor
from edge_agent.tcp_meter import TcpBytes, TcpMeter
from edge_agent.wire import Answer
from splitslam.security.client import Connector
from splitslam.security.settings import ClientTls
from splitslam.wire import session_pb2 as pb

_LOOK_S = 0.2  # while frames of a run before go first


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
        self._others = shared
        self._connector = Connector(server, tls or ClientTls())
        self._meter = TcpMeter(*split_server(server))
        self._dialogue = Dialogue(hello, settings, metrics, spool)
        self._shared = SharedDialogue(self._dialogue)
        self._changed, self._to_say = self._shared.changed, self._shared.to_say
        self._supervisor = Supervisor(server, self._connector, settings, metrics, self._meter, self._shared)
        metrics.tcp_bytes_from(lambda: self.tcp_bytes().sent, lambda: self.tcp_bytes().received)

    def start(self) -> None:
        """Begins to connect; returns at once."""
        self._supervisor.start()

    def wait_welcome(self) -> pb.Welcome | None:
        """Waits for the first Welcome; None when stopped meanwhile."""
        with self._changed:
            self._changed.wait_for(lambda: self._dialogue.first_welcome or self._shared.over)
            self._shared.raise_failure()
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
            self._shared.raise_failure()
            self._dialogue.keep(frame, time.monotonic(), arrived_s)
            self._to_say.notify_all()

    def take_answers(self) -> list[Answer]:
        """Answers since the last call, in the order they came; each frame's first answer only."""
        with self._changed:
            self._shared.raise_failure()
            answers, self._dialogue.answers = self._dialogue.answers, []
            return answers

    def wait_answers(self, timeout_s: float) -> list[Answer]:
        """The same, once there is one or so much time has passed."""
        with self._changed:
            self._changed.wait_for(lambda: self._dialogue.answers or self._shared.over, timeout_s)
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
            return _LOOK_S if self._others() else self._dialogue.spare_s(time.monotonic(), size)

    def spare_sent(self, size: int) -> None:
        """They go now; on another connection."""
        with self._changed:
            self._dialogue.spare_sent(time.monotonic(), size)

    @property
    def backlog(self) -> bool:
        """Whether frames of an outage still wait to be sent, this run's or another's."""
        with self._changed:
            return self._dialogue.outbox.unsent > BACKLOG_FRAMES or self._others()

    def wait_answered(self, seq: int) -> bool:
        """Waits until no frame up to `seq` lacks its answer; False when stopped meanwhile."""
        with self._changed:
            self._changed.wait_for(lambda: self._settled(seq) or self._shared.over)
            self._shared.raise_failure()
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
            self._changed.wait_for(lambda: self._dialogue.finished or self._shared.over)
            self._shared.raise_failure()
            return self._dialogue.finished

    def stop(self) -> None:
        """Whoever waits goes on at once, and the stream ends."""
        with self._changed:
            self._shared.closing = True
            self._shared.tell_all()

    def close(self) -> None:
        """Ends the stream, without Bye unless `finish` was called: the session can be resumed."""
        self.stop()
        self._supervisor.join()
        self._meter.settle()

    @property
    def anchored(self) -> bool:
        """The service follows the robot now: connected, nothing left to replay."""
        with self._changed:
            dialogue = self._dialogue
            return self._shared.stream is not None and dialogue.stream.welcomed and dialogue.outbox.unsent <= 1

    def certificate_expires_s(self) -> float:
        """Unix time of the first certificate to expire, s; NaN without TLS."""
        return self._connector.expires_s

    def tcp_bytes(self) -> TcpBytes:
        """TCP payload so far, all connections."""
        return self._meter.read()
