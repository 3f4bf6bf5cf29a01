"""One robot's stream as the front sees it, between the gRPC call and the worker."""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from dataclasses import dataclass

import grpc

from splitslam.wire import session_pb2 as pb

_MAX_QUEUED = 64  # beyond it a robot that does not read gets no more credits


@dataclass(frozen=True, slots=True)
class End:
    """The stream ends; status None: well."""

    status: grpc.StatusCode | None = None
    detail: str = ""


class RobotStream:
    """Answers on their way out, and how many frames are still unanswered."""

    def __init__(self, number: int, session_id: str, window: int) -> None:
        self.number, self.session_id, self.window = number, session_id, window
        self.outbox: asyncio.Queue[bytes | End] = asyncio.Queue()
        self.durable_seq = 0
        self.opened = False  # the worker has said something
        self.answered_s = math.nan  # when a frame was answered last
        self.took_s = math.nan  # and how long that was after it had come
        self.ending: End | None = None  # how it has ended from this side
        self._leaving: pb.Drain | None = None
        self._told = False
        self._slots = asyncio.Semaphore(window)
        self._received_s: deque[float] = deque()

    @property
    def answered(self) -> bool:
        """A frame of it has been answered."""
        return not math.isnan(self.answered_s)

    @property
    def unanswered(self) -> int:
        return len(self._received_s)

    @property
    def delay_s(self) -> float:
        """How long the oldest unanswered frame has waited."""
        return time.monotonic() - self._received_s[0] if self._received_s else 0.0

    @property
    def ended(self) -> bool:
        return self.ending is not None

    async def admit(self) -> None:
        """Wait until the window has room: a robot that sends more than its credit is not read any further."""
        await self._slots.acquire()
        self._received_s.append(time.monotonic())

    def put(self, body: bytes) -> None:
        if not self.ended:
            self.outbox.put_nowait(body)

    def put_answer(self, body: bytes) -> float | None:
        """Returns how long the frame took since it was received, s."""
        self.put(body)
        self.answered_s = time.monotonic()
        if not self._received_s:
            return None
        self._slots.release()
        self.took_s = time.monotonic() - self._received_s.popleft()
        return self.took_s

    def put_message(self, message: pb.StreamResponse) -> None:
        self.put(message.SerializeToString())

    def credit(self, durable_seq: int) -> None:
        """Sign of life."""
        self.durable_seq = max(self.durable_seq, durable_seq)
        if self.outbox.qsize() < _MAX_QUEUED:
            credit = pb.Credit(window=self.window, durable_seq=self.durable_seq)
            self.put_message(pb.StreamResponse(credit=credit))

    @property
    def leaving(self) -> bool:
        """The robot is about to be sent elsewhere: nothing more is read from it."""
        return self._leaving is not None

    def leave(self, drain: pb.Drain) -> None:
        """The robot will hear this when its session is handed over."""
        self._leaving = drain

    def handed(self, durable_seq: int) -> None:
        """It may go: all that was answered is durable. A robot whose session moves is let go at once."""
        self.tell()
        self.credit(durable_seq)
        if self._leaving is not None and self._leaving.reason == pb.DRAIN_REASON_REBALANCE:
            self.end()

    def tell(self) -> None:
        """Says Drain, once."""
        if self._leaving is not None and not self._told:
            self._told = True
            self.put_message(pb.StreamResponse(drain=self._leaving))

    def end(self, status: grpc.StatusCode | None = None, detail: str = "") -> None:
        """After what is queued."""
        if self.ending is None:
            self.ending = End(status, detail)
            self.outbox.put_nowait(self.ending)
