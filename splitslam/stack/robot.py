"""A light robot: plays encoded frames by the clock through the edge agent's own uplink and notes when answers come."""

from __future__ import annotations

import itertools
import threading
import time
from dataclasses import dataclass

from edge_agent.config import UplinkConfig
from edge_agent.metrics import EdgeMetrics
from edge_agent.uplink import Uplink
from edge_agent.wire import Answer
from splitslam.security.settings import ClientTls
from splitslam.stack.process import wait_until
from splitslam.stack.reel import Reel
from splitslam.wire import session_pb2 as pb

_LOOK_S = 0.1  # how often it looks whether it shall stop


@dataclass(frozen=True, slots=True)
class Heard:
    """A frame's first answer and when it came, s on the monotonic clock."""

    at_s: float
    answer: Answer


class LightRobot:
    """One run of `robot_id`. Frames are sent at `rate_hz` from `start` on until `finish` or the reel's end.

    heard: each frame's first answer. sent: how many frames so far. failure: what ended it.
    """

    def __init__(
        self,
        server: str,
        reel: Reel,
        robot_id: str,
        rate_hz: float = 10.0,
        uplink: UplinkConfig | None = None,
        run_id: str = "",
        tls: ClientTls | None = None,
    ) -> None:
        self.robot_id = robot_id
        self.metrics = EdgeMetrics()
        self.hello = reel.hello_of(robot_id, run_id)
        self.session_id = f"{robot_id}/{self.hello.run_id}"
        self.heard: list[Heard] = []
        self.sent = 0
        self.failure: Exception | None = None
        self._reel, self._period_s = reel, 1.0 / rate_hz
        self._uplink = Uplink(server, self.hello, uplink or UplinkConfig(), self.metrics, tls=tls)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, name=robot_id, daemon=True)

    def start(self) -> None:
        self._uplink.start()
        self._thread.start()

    def _play(self) -> None:
        try:
            if self._uplink.wait_welcome() is None:
                return
            due_s = time.monotonic()
            while not self._stop.is_set():
                left = self.sent < len(self._reel.frames)
                wait_s = due_s - time.monotonic() if left else _LOOK_S
                self._listen(min(max(wait_s, 0.0), _LOOK_S))
                if left and time.monotonic() >= due_s:
                    frame = pb.Frame()
                    frame.CopyFrom(self._reel.frames[self.sent])  # the uplink writes into it
                    self._uplink.send(frame)
                    self.sent += 1
                    due_s += self._period_s
        except Exception as error:  # for whoever asks: a thread has nobody to raise to
            self.failure = error

    def _listen(self, wait_s: float = 0.0) -> None:
        answers = self._uplink.wait_answers(wait_s)
        now_s = time.monotonic()
        self.heard += [Heard(now_s, answer) for answer in answers]

    def wait_answers(self, count: int, timeout_s: float = 30.0) -> None:
        """Until `count` frames are answered. Raises StackError, or what ended the robot."""
        wait_until(lambda: self.answered >= count or self.failure is not None, timeout_s, f"{count} answers")
        if self.failure is not None:
            raise self.failure

    def finish(self) -> pb.Finished:
        """Sends no more, waits for the last answer and says Bye. Raises what the uplink raised."""
        self._stop.set()
        self._thread.join()
        if self.failure is not None:
            raise self.failure
        finished = self._uplink.finish(self.sent)
        self._listen()
        self._uplink.close()
        assert finished is not None
        return finished

    def close(self) -> None:
        """Ends at once; the session stays open."""
        self._stop.set()
        self._uplink.stop()
        self._thread.join()
        self._uplink.close()

    @property
    def answered(self) -> int:
        """Frames with an answer so far."""
        return len(self.heard)

    @property
    def attempt(self) -> int:
        """How often it was sent on to another replica."""
        return self.hello.attempt

    def gap_s(self, since_s: float = 0.0, until_s: float = float("inf")) -> float:
        """The longest time between two answers that reaches into that span, the frames' own period included."""
        times = [heard.at_s for heard in self.heard]
        pairs = itertools.pairwise(times)
        return max((b - a for a, b in pairs if b > since_s and a < until_s), default=0.0)
