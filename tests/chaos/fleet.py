"""Light robots that never stop: when a session is finished it is judged, and its robot begins the next one."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

from splitslam.chaos.link import Link
from tests.chaos.invariants import Undisturbed, session_kept
from tests.chaos.light_robot import LightRobot

_TICK_S = 0.05
_OVER_S = 180.0  # what a session may take longer than its frames: a minute's outage, and catching up


@dataclass(slots=True)
class Place:
    """One robot of the fleet: its link, its present session, the one before."""

    name: str
    link: Link
    robot: LightRobot
    before: LightRobot | None = None

    @property
    def robots(self) -> list[LightRobot]:
        return [self.robot] if self.before is None else [self.before, self.robot]


class Fleet:
    """`size` robots, each behind a link of its own. `wrong` gathers what no session may show.

    stagger_s: between their starts, so that they do not all finish at once. frames: of each session; None: the whole
    drive.
    """

    def __init__(
        self, size: int, server: str, undisturbed: Undisturbed, *, frames: int | None = None, stagger_s: float = 0.0
    ) -> None:
        self._server, self._undisturbed, self._frames = server, undisturbed, frames
        self.wrong: list[str] = []
        self.judged = self.scans = 0
        self._last_lap = threading.Event()
        self.places = [self._place(f"light-{number}") for number in range(1, size + 1)]
        self._threads = [
            threading.Thread(target=self._keep, args=(place, stagger_s * k), name=place.name, daemon=True)
            for k, place in enumerate(self.places)
        ]

    def _place(self, name: str) -> Place:
        link = Link(self._server)
        return Place(name, link, self._robot(name, link))

    def _robot(self, name: str, link: Link) -> LightRobot:
        return LightRobot(name, self._undisturbed.reel, link.address, frames=self._frames)

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def _keep(self, place: Place, after_s: float) -> None:
        if self._last_lap.wait(after_s):
            return
        while True:
            robot = place.robot
            robot.start()
            if not robot.join(robot.duration_s + _OVER_S):
                robot.stop()
            self._judge(robot)
            if self._last_lap.is_set():
                return
            place.before, place.robot = robot, self._robot(place.name, place.link)

    def _judge(self, robot: LightRobot) -> None:
        self.wrong += session_kept(robot, self._server, self._undisturbed)
        self.judged += 1
        self.scans += robot.sent

    def settled(self, after_s: float, timeout_s: float) -> bool:
        """Waits until every robot has had an answer to a frame since `after_s`, with none older left open."""
        deadline_s = time.monotonic() + timeout_s
        while not all(place.robot.caught_up(after_s) for place in self.places):
            if time.monotonic() > deadline_s:
                return False
            time.sleep(_TICK_S)
        return True

    def gap_s(self, from_s: float, to_s: float) -> float:
        """The longest time that any robot waited for its next answer, of those that touch the two times."""
        return max(robot.gap_s(from_s, to_s) for place in self.places for robot in place.robots)

    def finish(self) -> None:
        """Lets every robot end its session, judges it, and closes the links."""
        self._last_lap.set()
        for thread in self._threads:
            thread.join()
        for place in self.places:
            place.link.close()
