"""What a map service maps, as it maps it: all robots that the caller may see, in one scene."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from splitslam.run.processes import RunFailedError
from splitslam.security.client import Connector
from splitslam.view.fetcher import FetchDone, FetchedKeyframe, FetchedWay, Fetcher
from splitslam.view.scene import Scene
from splitslam.view.session_view import SessionView
from splitslam.view.watches import Seen, Trouble, Watches
from splitslam.wire import view_pb2

_TICK_S = 0.1
_QUIET_S, _LAST_S = 0.5, 10.0


@dataclass(frozen=True, slots=True)
class Counts:
    """What has been shown. missed: scans that were dropped on the way because we were too slow; bad: messages."""

    robots: int
    scans: int
    missed: int
    bad: int


class LiveView:
    """Everything comes by one queue and is shown by one thread."""

    def __init__(
        self,
        scene: Scene,
        connector: Connector,
        note: Callable[[str], None],
        robot_id: str = "",
        site_id: str = "",
    ) -> None:
        """note: for lines that the user should read. robot_id, site_id: these alone; "": all."""
        self._scene, self._note = scene, note
        self._watches = Watches(connector, view_pb2.WatchScansRequest(robot_id=robot_id, site_id=site_id))
        self._fetcher = Fetcher(connector, self._watches.items.put)
        self._sessions: dict[str, SessionView] = {}
        self._bad = 0
        self.connected = threading.Event()
        self._told = ""

    def run(self, going_on: Callable[[], bool]) -> None:
        """Raises RunFailedError when the service will not show anything, whenever it is asked."""
        while going_on():
            self._step(_TICK_S)

    def finish(self) -> None:
        """What is still on its way, keyframes that were missed among it; no longer than some seconds."""
        deadline_s = time.monotonic() + _LAST_S
        quiet_s = time.monotonic()
        while time.monotonic() < deadline_s and time.monotonic() - quiet_s < _QUIET_S:
            if self._step(_TICK_S):
                quiet_s = time.monotonic()

    def close(self) -> None:
        self._watches.close()

    @property
    def counts(self) -> Counts:
        views = self._sessions.values()
        return Counts(len(views), sum(v.scans for v in views), sum(v.missed for v in views), self._bad)

    def _step(self, timeout_s: float) -> bool:
        """Whether something of a session has come."""
        try:
            item = self._watches.items.get(timeout=timeout_s)
        except queue.Empty:
            return False
        match item:
            case Seen():
                self._told = ""
                self.connected.set()
                self._watches.note(item)
                return self._seen(item.response)
            case Trouble():
                self._trouble(item)
                return False
            case FetchedKeyframe(session_id, keyframe):
                self._sessions[session_id].take_keyframe(keyframe)
            case FetchedWay(session_id, trajectory):
                self._sessions[session_id].take_way(trajectory)
            case FetchDone(session_id, problem):
                self._sessions[session_id].fetched()
                if problem:
                    self._note(f"{session_id}: what is stored of it was not fetched: {problem}")
        return True

    def _seen(self, response: view_pb2.WatchScansResponse) -> bool:
        if not response.session_id:
            return False
        session = self._session(response.session_id)
        try:
            session.take(response)
        except ValueError as error:
            self._bad += 1
            self._note(f"{response.session_id}: a message that does not hold together was dropped: {error}")
        if (wanted := session.wanted()) is not None:
            self._fetcher.fetch(wanted)
        return True

    def _session(self, session_id: str) -> SessionView:
        if session_id not in self._sessions:
            robot_id, _, run_id = session_id.partition("/")
            name = f"{robot_id} {run_id[:8]}" if robot_id in self._scene.robots else robot_id  # another run of it
            self._sessions[session_id] = SessionView(session_id, self._scene.robot(name))
        return self._sessions[session_id]

    def _trouble(self, trouble: Trouble) -> None:
        if trouble.final:
            raise RunFailedError(f"map service: WatchScans: {trouble.text}")
        if trouble.text != self._told:
            self._note(f"map service: {trouble.text}")
            self._told = trouble.text
