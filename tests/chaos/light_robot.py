"""Robots that cost little: the frames of one made drive, encoded once, sent at 10 Hz by the agent's own uplink.

A robot checks every message that comes back against the protocol and against the undisturbed run.
"""

from __future__ import annotations

import itertools
import threading
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_agent.config import UplinkConfig
from edge_agent.metrics import EdgeMetrics
from edge_agent.stream import Stream
from edge_agent.supervisor import Supervisor
from edge_agent.uplink import Uplink
from edge_agent.wire import Answer, matrix
from splitslam.stack.reel import Reel
from splitslam.wire import session_pb2 as pb
from tests import tolerances as bars

PERIOD_S = 0.1
_TICK_S = 0.01


@dataclass(slots=True)
class Witness:
    """Holds what the service says against docs/protocol.md; `wrong`: what was not as promised."""

    name: str
    wrong: list[str] = field(default_factory=list)
    epochs: list[int] = field(default_factory=list)
    durable_seq: int = 0
    _answers: dict[int, pb.Odometry] = field(default_factory=dict)
    _stream_answered: int = 0
    _welcomed: bool = False

    def stream_begins(self) -> None:
        self._welcomed = False

    def see(self, response: pb.StreamResponse) -> None:
        """Every message of the newest stream, in order."""
        kind = response.WhichOneof("message")
        if kind == "welcome":
            self._welcome(response.welcome)
        elif kind == "odometry":
            self._odometry(response.odometry)
        elif kind == "credit" and self._welcomed:  # before the Welcome it is a sign of life alone
            self._durable(response.credit.durable_seq, "a Credit")

    def expect(self, true: bool, text: str) -> None:
        if not true:
            self.wrong.append(f"{self.name}: {text}")

    def _welcome(self, welcome: pb.Welcome) -> None:
        self.expect(not self.epochs or welcome.epoch > self.epochs[-1], f"epoch {welcome.epoch} after {self.epochs}")
        self.epochs.append(welcome.epoch)
        self._welcomed = True
        self.expect(
            welcome.durable_seq <= welcome.applied_seq,
            f"a Welcome calls {welcome.durable_seq} durable and {welcome.applied_seq} applied",
        )
        self._durable(welcome.durable_seq, "a Welcome")
        self._stream_answered = 0

    def _durable(self, durable_seq: int, where: str) -> None:
        self.expect(durable_seq >= self.durable_seq, f"durable {durable_seq} in {where}, it was {self.durable_seq}")
        self.durable_seq = max(self.durable_seq, durable_seq)

    def _odometry(self, answer: pb.Odometry) -> None:
        self._durable(answer.durable_seq, f"the answer to {answer.seq}")
        self.expect(
            answer.durable_seq <= answer.applied_seq and answer.seq <= answer.applied_seq,
            f"answer to {answer.seq}: durable {answer.durable_seq}, applied {answer.applied_seq}",
        )
        self.expect(answer.seq > self._stream_answered, f"answer to {answer.seq} after that to {self._stream_answered}")
        self._stream_answered = answer.seq
        self.expect(not answer.rejected, f"frame {answer.seq} rejected: {answer.rejected}")
        first = self._answers.get(answer.seq)
        if first is not None and answer.duplicate:
            # The float64 pose that was stored is the one that was answered, unless it was not yet durable and its
            # owner died: then the frame has been mapped again, by the next one.
            same = first.pose_map_lidar == answer.pose_map_lidar or _apart_m(first, answer) < bars.CHAOS_REMAPPED_M
            self.expect(same, f"the duplicate answer to {answer.seq} is {_apart_m(first, answer):.4f} m off the first")
        self._answers[answer.seq] = answer


def _apart_m(a: pb.Odometry, b: pb.Odometry) -> float:
    return float(np.linalg.norm(matrix(a.pose_map_lidar)[:3, 3] - matrix(b.pose_map_lidar)[:3, 3]))


class _WitnessedSupervisor(Supervisor):
    """The agent's, with somebody who listens in."""

    def __init__(self, witness: Witness, *parts: Any) -> None:
        super().__init__(*parts)
        self._witness = witness
        self._heard: Stream | None = None

    def _on_response(self, stream: Stream, response: pb.StreamResponse) -> None:
        if self._shared.stream is stream:
            if self._heard is not stream:
                self._heard = stream
                self._witness.stream_begins()
            self._witness.see(response)
        super()._on_response(stream, response)


class _WitnessedUplink(Uplink):
    def __init__(self, server: str, hello: pb.Hello, witness: Witness) -> None:
        settings, metrics = UplinkConfig(), EdgeMetrics(keep=False)
        super().__init__(server, hello, settings, metrics)
        parts = server, self._connector, settings, metrics, self._meter, self._shared
        self._supervisor = _WitnessedSupervisor(witness, *parts)


@dataclass(slots=True)
class Arrival:
    """The first answer to a frame, when it came (monotonic clock)."""

    at_s: float
    answer: Answer


class LightRobot:
    """One session, played from its first frame to its last and finished; a thread of its own."""

    def __init__(self, name: str, reel: Reel, server: str, *, frames: int | None = None) -> None:
        self.name, self._reel, self.count = name, reel, frames or len(reel.frames)
        self.session_id = ""
        self.arrivals: dict[int, Arrival] = {}
        self.sent = 0
        self.finished: pb.Finished | None = None
        self.failure: Exception | None = None
        self.witness = Witness(name)
        self._uplink = _WitnessedUplink(server, reel.hello_of(name), self.witness)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        self._uplink.start()
        self._thread.start()

    def join(self, timeout_s: float) -> bool:
        """True when it has come to its end in time."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    @property
    def duration_s(self) -> float:
        """What its frames take."""
        return self.count * PERIOD_S

    def caught_up(self, since_s: float) -> bool:
        """It has ended, or a frame sent since then is answered and at most two wait."""
        if not self._thread.is_alive():
            return self._thread.ident is not None
        arrivals = self.arrivals
        newest = arrivals.get(len(arrivals))
        return newest is not None and newest.at_s > since_s + PERIOD_S and self.sent - len(arrivals) <= 2

    def stop(self) -> None:
        """Ends it where it stands: the session stays open."""
        self._stopping.set()
        self._uplink.stop()
        self._thread.join()

    def _run(self) -> None:
        try:
            self._play()
        except Exception as error:  # told by whoever waits for the robot
            self.failure = error
        finally:
            self._uplink.close()

    def _play(self) -> None:
        welcome = self._uplink.wait_welcome()
        if welcome is None:
            return
        self.session_id = welcome.session_id
        start_s = time.monotonic()
        while not self._stopping.is_set() and self.sent < self.count:
            due = min(self.count, int((time.monotonic() - start_s) / PERIOD_S) + 1)
            while self.sent < due:
                frame = pb.Frame()
                frame.CopyFrom(self._reel.frames[self.sent])  # the uplink writes into it
                self._uplink.send(frame)
                self.sent += 1
            self._note_answers()
            time.sleep(_TICK_S)
        while not self._stopping.is_set() and len(self.arrivals) < self.sent:
            self._note_answers()
            time.sleep(_TICK_S)
        if not self._stopping.is_set():
            self.finished = self._uplink.finish(self.sent)

    def _note_answers(self) -> None:
        for answer in self._uplink.take_answers():
            seq = answer.reply.seq
            rejected = answer.reply.rejected
            self.witness.expect(seq not in self.arrivals, f"frame {seq} answered twice")
            self.witness.expect(not rejected, f"frame {seq}: its answer is not taken: {rejected}")
            self.arrivals[seq] = Arrival(time.monotonic(), answer)

    # --- what it has seen -------------------------------------------------------------------------------------

    def gap_s(self, from_s: float = float("-inf"), to_s: float = float("inf")) -> float:
        """The longest time without an answer that ends or begins between the two times."""
        at_s = sorted(arrival.at_s for arrival in list(self.arrivals.values()))
        return max((b - a for a, b in itertools.pairwise(at_s) if b >= from_s and a <= to_s), default=0.0)

    def off_m(self) -> NDArray[np.float64]:
        """(N,) How far each answered pose is from the undisturbed run's, by seq, m."""
        seqs = sorted(self.arrivals)
        poses = np.array([self.arrivals[seq].answer.reply.T_map_lidar[:3, 3] for seq in seqs]).reshape(-1, 3)
        wanted = np.array([self._reel.T_map_lidar[seq - 1][:3, 3] for seq in seqs]).reshape(-1, 3)
        return np.linalg.norm(poses - wanted, axis=1)
