"""A recording as a stream of scans, IMU samples, wheel odometry and GNSS fixes, in the order they were recorded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from edge_agent.sources import topics
from edge_agent.sources.bag import Bag
from edge_agent.sources.decoding import Decoding
from edge_agent.sources.source import Tap, TimedEvent
from splitslam.errors import InputError
from splitslam.robot import Robot

_TAIL_NS = 500_000_000  # after the last scan wanted: how long to read on for IMU samples that cover it


def open_recording(path: Path, robot: Robot, *, max_scans: int | None = None) -> Recording:
    """Opens a recording and checks it against the robot file.

    Raises InputError (one line) when the recording is missing, damaged or has no scans, when a topic is missing or of
    the wrong type, or when the robot file does not fit (model, rings, T_lidar_imu).
    """
    bag = Bag(path)
    try:
        return Recording(bag, robot, max_scans)
    except BaseException:
        bag.close()
        raise


class Recording:
    """A Source: one pass over a recording. scan_count: by its index. start_ns, end_ns: in recorded time."""

    def __init__(self, bag: Bag, robot: Robot, max_scans: int | None) -> None:
        self.tap: Tap | None = None
        self.live_offset_ns = None
        self._bag = bag
        self._name = str(bag.path)
        self._max_scans = max_scans
        self.start_ns = 0
        self.end_ns = 0
        there = bag.topics()
        choice = topics.choose_all(robot, there, self._name)
        self.robot, self.topics = choice.robot, choice.chosen
        self._check(robot, there)
        lidar_topic = self.topics["lidar"]
        self.scan_count = min(bag.count(lidar_topic), max_scans if max_scans is not None else 2**62)
        self._decoding = Decoding(self.robot, self.topics, there[lidar_topic], self._name)
        self._decoding.look_at(message for _, _, message in bag.messages({lidar_topic}))
        self.counts, self.dropped = self._decoding.counts, self._decoding.dropped
        self.beam_elevations_rad = self._decoding.beam_elevations_rad
        self.notes = [*choice.notes, *self._decoding.notes]

    def events(self) -> Iterator[TimedEvent]:
        """(arrival time ns, event) in recording order; closes the recording at its end.

        A message that cannot be used is counted in `dropped` and left out.
        """
        stop_ns: int | None = None
        with self._bag:
            for topic, arrival_ns, message in self._bag.messages(set(self.topics.values()), self.tap):
                is_scan = topic == self.topics["lidar"]
                if stop_ns is not None and arrival_ns > stop_ns:
                    return
                if is_scan and self.counts.scans_read == self._max_scans:
                    continue
                self.start_ns = min(self.start_ns or arrival_ns, arrival_ns)
                self.end_ns = max(self.end_ns, arrival_ns)
                event = self._decoding.event(topic, message)
                if is_scan and self.counts.scans_read == self._max_scans:
                    stop_ns = arrival_ns + (_TAIL_NS if "imu" in self.topics else 0)
                if event is not None:
                    yield arrival_ns, event

    def status(self) -> str:
        """Nothing: a recording is what it is."""
        return ""

    def close(self) -> None:
        """Closes the file when `events` was not read to its end."""
        self._bag.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _check(self, robot: Robot, there: dict[str, str]) -> None:
        self._bag.check_definitions(set(self.topics.values()))
        if "lidar" not in self.topics or self._bag.count(self.topics["lidar"]) == 0:
            raise InputError(
                f"{self._name}: no scans: expected messages of type sensor_msgs/PointCloud2 or"
                f" velodyne_msgs/VelodyneScan; there are: {topics.listing(there)}"
            )
        if "imu" in self.topics and not robot.imu_placed:
            raise InputError(
                f"{self._name}: robot file: T_lidar_imu: must be given: the recording has an IMU on"
                f" {self.topics['imu']} (or set imu: null)"
            )
