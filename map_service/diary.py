"""A session's events since its last commit: what its answers say, and what its pipeline has noted."""

from __future__ import annotations

from map_service import event_messages as messages
from map_service.types import Commit, MapAnswer, State
from splitslam.wire import pose_pb2 as pb


class Diary:
    """Events become durable with the frames that they are of, or not at all: none is told that did not stay."""

    def __init__(self) -> None:
        self._events: list[pb.Event] = []

    def answered(self, answer: MapAnswer, before: State) -> None:
        """before: the tracking state of the answer before."""
        seq, stamp_ns = answer.seq, answer.stamp_ns
        if answer.state != before:
            self._events.append(messages.state_event(seq, stamp_ns, before, answer.state))
        if answer.correction is not None:
            self._events.append(messages.correction_event(seq, stamp_ns, answer.correction))

    def take(self, commit: Commit, last_stamp_ns: int, *, finished: bool) -> list[bytes]:
        """Everything that belongs to a commit, serialised, in order of frames."""
        events = [*self._events, *(messages.happened_event(happened) for happened in commit.happened)]
        self._events = []
        for (metric, reason), count in commit.outcomes.items():
            if metric == "loops" and reason != "accepted":
                events.append(messages.loops_rejected_event(commit.last_seq, last_stamp_ns, reason, count))
        events.sort(key=lambda event: event.seq)  # stable: those of a frame stay as they were noted
        if finished:
            events.append(messages.ended_event(commit.last_seq, last_stamp_ns))
        return [event.SerializeToString() for event in events]
