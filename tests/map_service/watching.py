"""Somebody who follows sessions, on a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator

import grpc

from splitslam.map_client import MapClient
from splitslam.wire import pose_pb2 as pb

WAIT_S = 20.0


class Follower:
    """Notes every message of a call; `error` is what ended it."""

    def __init__(self, messages: Iterator) -> None:
        self.messages: list = []
        self.at_s: list[float] = []
        self.error: grpc.RpcError | None = None
        self._call = messages
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def _follow(self) -> None:
        try:
            for message in self._call:
                self.messages.append(message)
                self.at_s.append(time.monotonic())
        except (grpc.RpcError, ValueError) as error:  # ValueError: the channel was closed
            self.error = error if isinstance(error, grpc.RpcError) else None

    @property
    def poses(self) -> list[pb.ScanPose]:
        return [pose for message in list(self.messages) for pose in message.poses]

    @property
    def moved(self) -> list[pb.MovedKeyframes]:
        return [message.moved for message in list(self.messages) if message.HasField("moved")]

    @property
    def events(self) -> list[pb.Event]:
        return [event for message in list(self.messages) for event in message.events]

    def seqs(self, session_id: str = "") -> list[int]:
        return [pose.seq for pose in self.poses if session_id in ("", pose.session_id)]

    def wait(self, what: Callable[[Follower], bool], why: str, timeout_s: float = WAIT_S) -> None:
        until_s = time.monotonic() + timeout_s
        while not what(self):
            assert time.monotonic() < until_s, f"{why}: {self.error or self.messages[-3:]}"
            time.sleep(0.01)

    def wait_seq(self, seq: int, session_id: str = "") -> None:
        self.wait(lambda f: bool(f.seqs(session_id)) and f.seqs(session_id)[-1] >= seq, f"scan {seq}")

    def end(self) -> None:
        """Waits until the service ends the call."""
        self._thread.join(WAIT_S)
        assert not self._thread.is_alive(), "the call goes on"


def of(*session_ids: str) -> pb.SessionSelection:
    return pb.SessionSelection(session_ids=session_ids)


def kinds(events: Iterable[pb.Event]) -> list[str | None]:
    return [event.WhichOneof("what") for event in events]


def follow(client: MapClient, session_id: str = "", *, from_start: bool = True) -> Follower:
    """Poses of one session, or of all."""
    selection = of(session_id) if session_id else None
    return Follower(client.watch_poses(selection, from_start=from_start))
