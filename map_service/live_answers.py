"""Answers to robots, handed to those who follow their sessions in this replica. Costs nothing where nobody does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from map_service.pose_track import TrackedScan
from map_service.scan_poses import live_scan


class LiveAnswer:
    """An answer to a frame of a session, read once however many follow it. body: serialised StreamResponse."""

    def __init__(self, stream: int, session_id: str, body: bytes) -> None:
        self.stream, self.session_id = stream, session_id
        self._body: bytes | None = body
        self._scan: TrackedScan | None = None

    def scan(self, T_lidar_body: NDArray[np.float64]) -> TrackedScan | None:
        """None: the frame was answered before. T_lidar_body: (4, 4), of the session's robot."""
        if self._body is not None:
            self._scan, self._body = live_scan(self.session_id, self._body, T_lidar_body), None
        return self._scan


Listener = Callable[[LiveAnswer], None]


class LiveAnswers:
    """Used by the event loop alone. A listener must not wait."""

    def __init__(self) -> None:
        self._listeners: list[Listener] = []

    def tell(self, stream: int, session_id: str, body: bytes) -> None:
        """A frame of the session was answered."""
        if self._listeners:
            answer = LiveAnswer(stream, session_id, body)
            for listener in self._listeners:
                listener(answer)

    @contextmanager
    def heard_by(self, listener: Listener) -> Iterator[None]:
        """As long as the block runs."""
        self._listeners.append(listener)
        try:
            yield
        finally:
            self._listeners.remove(listener)
