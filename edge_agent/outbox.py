"""The frames the robot still owes the map service: kept until they are durable there and answered.

Pure bookkeeping without a lock; uplink.py guards it. Frames lie on disk from the moment they are made, if there is a
spool and it takes them; the first of them are in memory as well, and those that the disk does not take are there only.
"""

from __future__ import annotations

import itertools
from collections import OrderedDict
from dataclasses import dataclass

from edge_agent.shelf import Shelf
from edge_agent.spool import Spool
from splitslam.wire import session_pb2 as pb

_MOVED_AT_ONCE = 50  # frames that go to disk with a new one after the disk was away


@dataclass(slots=True)
class Held:
    """One kept frame. frame: None while it is on disk only. answered: its first answer was handed on, or an agent
    before had it. sent: on the present stream. inherited: made by an agent before. arrived_s: when its scan came."""

    frame: pb.Frame | None
    size: int
    queued_s: float
    answered: bool = False
    sent: bool = False
    inherited: bool = False
    arrived_s: float | None = None


@dataclass(frozen=True, slots=True)
class Lost:
    """A frame that had to go. reason: buffer_full; buffer_full_after_answer, lost only if the server dies;
    spool_damaged."""

    seq: int
    reason: str


class Outbox:
    """Frames in seq order, the in-flight window, and what has been answered and stored.

    limit_bytes: of frames that are in memory only. lost: to be counted by whoever reads it.
    """

    def __init__(self, limit_bytes: int, window: int, spool: Spool | None = None, copies_bytes: int = 0) -> None:
        """copies_bytes: of frames that are in memory and on disk."""
        self.limit_bytes, self.window = limit_bytes, window
        self.bytes = 0
        self.durable_seq = 0
        self.released_seq = 0  # newest frame that was let go because it is durable
        self.lost: list[Lost] = []
        self._spool, self._copies_bytes = spool, copies_bytes
        self._held: OrderedDict[int, Held] = OrderedDict()
        self._in_flight: dict[int, None] = {}
        self._unsent: OrderedDict[int, None] = OrderedDict()
        self._missing: set[int] = set()
        self._memory, self._disk, self._copies = Shelf(), Shelf(), Shelf()
        if spool is not None:
            self._inherit(spool)

    def _inherit(self, spool: Spool) -> None:
        """Takes over what an agent before has left on disk."""
        recovery = spool.recovered
        self.released_seq = recovery.durable_seq
        for head in recovery.heads:
            self._held[head.seq] = Held(None, head.body_bytes, 0.0, inherited=True)
            self._disk.add(head.seq, head.body_bytes, head.dense)
            self.bytes += head.body_bytes
        if recovery.newest is not None:
            first, newest = self.released_seq + 1, recovery.newest
            self._missing = {seq for seq in range(first, newest.seq + 1) if seq not in self._held}
            if 1 in self._missing:
                oldest = min((head.stamp_ns for head in recovery.heads), default=newest.stamp_ns)
                self._stand_in(oldest - 1)
        self._unsent = OrderedDict.fromkeys(sorted(self._held))

    def __len__(self) -> int:
        return len(self._held)

    @property
    def all_on_disk(self) -> bool:
        """Every kept frame is on disk, the newest among them."""
        return self._spool is not None and not len(self._memory)

    @property
    def in_flight(self) -> int:
        return len(self._in_flight)

    @property
    def unsent(self) -> int:
        return len(self._unsent)

    def arrived_s(self, seq: int) -> float | None:
        """When the scan of a kept frame came, on the clock of `add`; None: not known."""
        return self._held[seq].arrived_s

    def first_unanswered(self) -> int | None:
        """Lowest seq that still waits for its first answer."""
        return next((seq for seq, held in self._held.items() if not held.answered), None)

    def add(self, frame: pb.Frame, now_s: float, arrived_s: float | None = None) -> None:
        """Keeps `frame`, whose seq is above all others; what makes room for it is `lost`."""
        size = frame.ByteSize()
        self._held[frame.seq] = Held(frame, size, now_s, arrived_s=arrived_s)
        self._unsent[frame.seq] = None
        self.bytes += size
        self._memory.add(frame.seq, size, frame.dense)
        if self._spool is not None:
            self._to_disk(self._spool)
            while self._spool.overfull and (seq := self._disk.victim(self._in_flight)) is not None:
                self._give_up(seq)
        while self._memory.bytes > self.limit_bytes and (seq := self._memory.victim(self._in_flight)) is not None:
            self._give_up(seq)

    def _to_disk(self, spool: Spool) -> None:
        """What is in memory only goes to disk, oldest first, as far as the disk takes it."""
        for _ in range(_MOVED_AT_ONCE):
            if (seq := self._memory.oldest()) is None:
                return
            held = self._held[seq]
            assert held.frame is not None
            if not spool.put(held.frame, self.durable_seq):
                return
            self._memory.remove(seq)
            self._disk.add(seq, held.size, held.frame.dense)
            if self._copies.bytes + held.size <= self._copies_bytes:
                self._copies.add(seq, held.size, held.frame.dense)
            else:
                held.frame = None

    def _give_up(self, seq: int) -> None:
        self.lost.append(Lost(seq, "buffer_full_after_answer" if self._held[seq].answered else "buffer_full"))
        self._lose(seq)

    def _lose(self, seq: int) -> None:
        frame = self._held[seq].frame
        self._missing.add(seq)
        if self._spool is not None and seq in self._spool:
            self._spool.give_up(seq)
        self._forget(seq)
        if seq == 1 and self.durable_seq == 0:
            self._stand_in(frame.stamp_ns if frame is not None else 0)

    def _stand_in(self, stamp_ns: int) -> None:
        """A session cannot begin with a hole: the service rejects an empty first frame and goes on behind it."""
        empty = pb.Frame(seq=1, stamp_ns=stamp_ns)
        self._missing.discard(1)
        self._held[1] = Held(empty, empty.ByteSize(), 0.0, answered=True)
        self._held.move_to_end(1, last=False)
        self._unsent[1] = None
        self._unsent.move_to_end(1, last=False)
        self.bytes += empty.ByteSize()

    def rewind(self, applied_seq: int, durable_seq: int) -> bool:
        """A new stream begins: what the server has not applied, and what is unanswered, goes (again) in seq order.

        False: the server has lost frames that it had called durable, so nothing here can fill the hole.
        """
        if durable_seq < self.released_seq:
            return False
        self._in_flight.clear()
        for seq, held in self._held.items():
            held.sent = False
            held.answered |= held.inherited and seq <= applied_seq  # nobody waits for that answer any more
        self._unsent = OrderedDict((s, None) for s, h in self._held.items() if s > applied_seq or not h.answered)
        self.mark_durable(durable_seq)
        return True

    def next_size(self) -> int:
        """Bytes of the frame that `next_frame` would give; 0 for none."""
        if not self._unsent or len(self._in_flight) >= self.window:
            return 0
        return self._held[next(iter(self._unsent))].size

    def next_frame(self) -> pb.Frame | None:
        """The next frame to put on the stream, or None while the window is full or nothing waits."""
        while self._unsent and len(self._in_flight) < self.window:
            seq = next(iter(self._unsent))
            if (frame := self._frame(seq)) is None:
                self.lost.append(Lost(seq, "spool_damaged"))
                self._lose(seq)
                continue
            del self._unsent[seq]
            self._held[seq].sent = True
            self._in_flight[seq] = None
            before = seq - 1
            while before in self._missing:
                before -= 1
            frame.follows_seq = before if before != seq - 1 else 0  # a hole is declared, or the server waits for it
            return frame
        return None

    def _frame(self, seq: int) -> pb.Frame | None:
        held = self._held[seq]
        if held.frame is None and self._spool is not None:
            return self._spool.get(seq)
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
        if durable_seq > self.durable_seq:
            self.durable_seq = durable_seq
            self._missing = {seq for seq in self._missing if seq >= durable_seq}
        prefix = itertools.takewhile(lambda seq: seq <= self.durable_seq, self._held)
        done = [seq for seq in prefix if self._held[seq].answered and seq not in self._in_flight]
        for seq in done:
            self.released_seq = max(self.released_seq, seq)
            if self._spool is not None and seq in self._spool:
                self._spool.release(seq)
            self._forget(seq)

    def _forget(self, seq: int) -> None:
        self.bytes -= self._held.pop(seq).size
        self._unsent.pop(seq, None)
        for shelf in (self._memory, self._disk, self._copies):
            shelf.remove(seq)
