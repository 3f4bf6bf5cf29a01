"""The frames the robot still owes the map service: kept until they are durable there and answered.

Pure bookkeeping without a lock; uplink.py guards it. The memory here is where a disk spool will continue.
"""

from __future__ import annotations

import itertools
from collections import OrderedDict
from dataclasses import dataclass

from splitslam.wire import session_pb2 as pb


@dataclass(slots=True)
class Held:
    """One kept frame. `answered`: its first answer was handed on. `sent`: on the present stream."""

    frame: pb.Frame
    size: int
    queued_s: float
    answered: bool = False
    sent: bool = False


@dataclass(frozen=True, slots=True)
class Evicted:
    """A frame that had to go because the buffer was full; `answered` ones are only lost if the server dies."""

    seq: int
    answered: bool


class Outbox:
    """Frames in seq order, the in-flight window, and what has been answered and stored."""

    def __init__(self, limit_bytes: int, window: int) -> None:
        self.limit_bytes, self.window = limit_bytes, window
        self.bytes = 0
        self.durable_seq = 0
        self.released_seq = 0  # newest frame that was let go because it is durable
        self._held: OrderedDict[int, Held] = OrderedDict()
        self._in_flight: dict[int, None] = {}
        self._unsent: OrderedDict[int, None] = OrderedDict()
        self._evicted: set[int] = set()

    def __len__(self) -> int:
        return len(self._held)

    @property
    def in_flight(self) -> int:
        return len(self._in_flight)

    @property
    def unsent(self) -> int:
        return len(self._unsent)

    def first_unanswered(self) -> int | None:
        """Lowest seq that still waits for its first answer."""
        return next((seq for seq, held in self._held.items() if not held.answered), None)

    def add(self, frame: pb.Frame, now_s: float) -> list[Evicted]:
        """Keeps `frame`, whose seq is above all others; says which frames made room for it."""
        size = frame.ByteSize()
        self._held[frame.seq] = Held(frame, size, now_s)
        self._unsent[frame.seq] = None
        self.bytes += size
        evicted = []
        while self.bytes > self.limit_bytes and (seq := self._victim()) is not None:
            evicted.append(Evicted(seq, self._held[seq].answered))
            self._evicted.add(seq)
            self._forget(seq)
        return evicted

    def _victim(self) -> int | None:
        """Oldest frame that is not dense; a dense one only when no other is left. Never one in flight."""
        idle = [seq for seq in self._held if seq not in self._in_flight]
        return next((seq for seq in idle if not self._held[seq].frame.dense), idle[0] if idle else None)

    def rewind(self, applied_seq: int, durable_seq: int) -> bool:
        """A new stream begins: what the server has not applied, and what is unanswered, goes (again) in seq order.

        False: the server has lost frames that it had called durable, so nothing here can fill the hole.
        """
        if durable_seq < self.released_seq:
            return False
        self._in_flight.clear()
        self._unsent = OrderedDict((s, None) for s, h in self._held.items() if s > applied_seq or not h.answered)
        for held in self._held.values():
            held.sent = False
        self.mark_durable(durable_seq)
        return True

    def next_size(self) -> int:
        """Bytes of the frame that `next_frame` would give; 0 for none."""
        if not self._unsent or len(self._in_flight) >= self.window:
            return 0
        return self._held[next(iter(self._unsent))].size

    def next_frame(self) -> pb.Frame | None:
        """The next frame to put on the stream, or None while the window is full or nothing waits."""
        if not self._unsent or len(self._in_flight) >= self.window:
            return None
        seq, _ = self._unsent.popitem(last=False)
        held = self._held[seq]
        held.sent = True
        self._in_flight[seq] = None
        before = seq - 1
        while before in self._evicted:
            before -= 1
        held.frame.follows_seq = before if before != seq - 1 else 0  # a hole is declared, or the server waits for it
        return held.frame

    def answer(self, seq: int) -> Held | None:
        """Takes the answer to `seq`; the held frame when this is its first answer, else None."""
        self._in_flight.pop(seq, None)
        held = self._held.get(seq)
        if held is None or held.answered or not held.sent:
            return None
        held.answered = True
        self.mark_durable(self.durable_seq)
        return held

    def was_answered(self, seq: int) -> bool:
        """Whether the answer to `seq` has been handed on."""
        held = self._held.get(seq)
        return held.answered if held else seq <= self.released_seq

    def mark_durable(self, durable_seq: int) -> None:
        """Lets go of every answered frame that survives the loss of the server."""
        self.durable_seq = max(self.durable_seq, durable_seq)
        self._evicted = {seq for seq in self._evicted if seq >= self.durable_seq}
        prefix = itertools.takewhile(lambda seq: seq <= self.durable_seq, self._held)
        done = [seq for seq in prefix if self._held[seq].answered and seq not in self._in_flight]
        for seq in done:
            self.released_seq = max(self.released_seq, seq)
            self._forget(seq)

    def _forget(self, seq: int) -> None:
        self.bytes -= self._held.pop(seq).size
        self._unsent.pop(seq, None)
