"""A live source on free ports, and captures sent to it."""

from __future__ import annotations

import os
import pty
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from edge_agent.live_settings import LiveConfig
from edge_agent.sources import Event, TimedEvent
from edge_agent.sources.live.opening import open_live
from edge_agent.sources.live.source import LiveSource
from splitslam.robot import Robot, load_robot

UDP = {"host": "127.0.0.1", "port": 0, "position_port": 0, "imu_port": 0}


def velodyne_robot(model: str, **sections: Any) -> Robot:
    lidar = {"model": model, "min_range_m": 0.0, "max_range_m": 1000.0}
    return Robot.model_validate({"lidar": lidar, "imu": None, "gnss": None} | sections)


def ouster_robot(metadata: Path, folder: Path, **sections: str) -> Robot:
    path = folder / "robot.yaml"
    text = f"lidar: {{model: ouster, metadata: {metadata}, min_range_m: 0.0, max_range_m: 1000.0}}\ngnss: null\n"
    path.write_text(text + "".join(f"{key}: {value}\n" for key, value in sections.items()))
    return load_robot(path)


def config(**sections: Any) -> LiveConfig:
    return LiveConfig.model_validate({"lidar": {"udp": UDP}} | sections)


def ports_of(source: LiveSource) -> list[int]:
    """Of its UDP ports, in the order in which they were opened."""
    return [getattr(input.port, "port", 0) for input in source.inputs]


class Listener:
    """Iterates a source in a thread, as the agent's reader does."""

    def __init__(self, source: LiveSource) -> None:
        self.source = source
        self.heard: list[TimedEvent] = []
        self.rests = 0
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self) -> None:
        for timed in self.source.events():
            if timed is None:
                self.rests += 1
            else:
                self.heard.append(timed)

    def of(self, kind: type[Any]) -> list[Any]:
        """The events of a type."""
        return [event for _, event in self.heard if isinstance(event, kind)]

    def until(self, done: Callable[[], bool], timeout_s: float = 20.0) -> None:
        deadline_s = time.monotonic() + timeout_s
        while not done():
            assert time.monotonic() < deadline_s, (len(self.heard), self.source.packets())
            time.sleep(0.01)

    def until_quiet(self, quiet_s: float = 0.6) -> None:
        """Nothing more has come, and all that waited has been handed on."""
        self.until(lambda: self._packets() > 0)
        before = None
        while self._waits() or before != (self._packets(), len(self.heard)):
            before = self._packets(), len(self.heard)
            time.sleep(quiet_s)

    def _waits(self) -> bool:
        """Something has come that the source has not read yet, as it may be on a busy machine."""
        poll = select.poll()
        for one in self.source.inputs:
            if one.port.fileno is not None:
                poll.register(one.port.fileno, select.POLLIN)
        return any(event & select.POLLIN for _, event in poll.poll(0))

    def _packets(self) -> float:
        return sum(self.source.packets().values())

    def close(self) -> float:
        """Ends it; how long that took, s."""
        began_s = time.monotonic()
        self.source.close()
        self._thread.join(20.0)
        assert not self._thread.is_alive()
        return time.monotonic() - began_s


@contextmanager
def listening(robot: Robot, settings: LiveConfig) -> Iterator[Listener]:
    listener = Listener(open_live(settings, robot))
    try:
        yield listener
    finally:
        listener.close()


@contextmanager
def terminal(folder: Path, name: str = "tty") -> Iterator[tuple[Path, int]]:
    """A serial device, and the file descriptor of its other end."""
    controller, end = pty.openpty()
    tty.setraw(end)
    device = folder / name
    device.symlink_to(os.ttyname(end))
    try:
        yield device, controller
    finally:
        os.close(controller)
        os.close(end)


def counts(source: LiveSource, sensor: str) -> Mapping[str, float]:
    """What became of a sensor's packets, zeros left out."""
    return {result: count for (of, result), count in source.packets().items() if of == sensor and count}


def events_of(listener: Listener) -> list[Event]:
    return [event for _, event in listener.heard]
