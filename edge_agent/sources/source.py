"""What the agent reads: a recording, live sensors or ROS topics, all behind one interface."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from edge_agent.raw_ring import RawStream
from splitslam.robot import Robot
from splitslam.scan import GnssFix, ImuSamples, Scan, WheelSamples

if TYPE_CHECKING:
    import threading

    from edge_agent.config import AgentConfig
    from edge_agent.metrics import EdgeMetrics

Event = Scan | ImuSamples | WheelSamples | GnssFix
TimedEvent = tuple[int, Event]  # arrival, ns
Tap = Callable[[RawStream, int, bytes], None]  # stream, arrival ns, message as it came


class StoppedError(Exception):
    """The agent is to end, and its sensors have never been there."""


@dataclass(slots=True)
class Counts:
    """What has been read so far.

    read_points: valid points, after the gates. native_bytes: the sensor's own packets, 0 when there are none.
    left_out: points that were left out, by reason: nan, zero, gated (range), cropped, unknown_ring.
    """

    scans_read: int = 0
    imu_messages: int = 0
    read_points: int = 0
    native_bytes: int = 0
    left_out: Counter[str] = field(default_factory=Counter)


class Source(Protocol):
    """Scans, IMU samples, wheel odometry and GNSS fixes, in the order in which they came. `events` is iterated once.

    robot: the robot file with the chosen topics filled in; imu, wheels and gnss None when the source has none.
    topics: sensor -> topic, by which the raw ring and `splitslam diagnose` know it.
    notes: lines to print once.
    counts, dropped: what has been read; messages that could not be used, by reason.
    start_ns, end_ns: arrival of the first and the last message so far, 0 before the first.
    scan_count: scans to expect; None: the source does not end.
    live_offset_ns: None for a recording. For a live source, whose arrivals are `time.monotonic_ns() + live_offset_ns`:
    a clock that looks like the Unix time at the start, and never steps.
    beam_elevations_rad: (rings,) float32.
    tap: set it before `events` to see each message raw.
    """

    robot: Robot
    topics: dict[str, str]
    notes: list[str]
    counts: Counts
    dropped: Counter[str]
    start_ns: int
    end_ns: int
    beam_elevations_rad: NDArray[np.float32]
    tap: Tap | None

    @property
    def scan_count(self) -> int | None: ...
    @property
    def live_offset_ns(self) -> int | None: ...

    def events(self) -> Iterator[TimedEvent | None]:
        """(arrival ns, event). A message that cannot be used is counted in `dropped` and left out.

        A live source yields None when all that has come is handed over, and at least four times a second while nothing
        comes: that is how its reader hands batches on, ends at once, and is told from one that is stuck. Live events
        never end by themselves.
        """
        ...

    def status(self) -> str:
        """What of the sensors needs looking at now, for the status line: `imu silent for 12 s`; "" for nothing."""
        ...

    def close(self) -> None:
        """Ends `events` at once, of a live source from any thread. Twice is no error."""
        ...


def open_source(config: AgentConfig, robot: Robot, metrics: EdgeMetrics, stop: threading.Event) -> Source:
    """The source that the configuration names. Raises InputError (one line) for what the user can mend.

    stop: ends the wait for sensors that are not there yet, with StoppedError.
    """
    source = config.source
    if source.live is not None:
        from edge_agent.sources.live.opening import open_live

        live = open_live(source.live, robot)
        metrics.live_from(live.packets, lambda: live.presence.losses, live.clocks)
        return live
    if source.ros is not None:
        from edge_agent.ros.source import open_ros

        return open_ros(source.ros, config.ros, robot, stop)
    from edge_agent.sources.recording import open_recording

    assert source.recording is not None  # the configuration has exactly one
    return open_recording(source.recording, robot, max_scans=source.max_scans)
