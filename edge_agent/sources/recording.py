"""A recording as a stream of scans, IMU samples, wheel odometry and GNSS fixes, in the order they were recorded."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_agent.sources import beams, messages, topics
from edge_agent.sources.bag import Bag
from edge_agent.sources.cloud_decoder import CloudDecoder
from edge_agent.sources.pointcloud2 import read_table
from edge_agent.sources.raw import Gate, RawScan
from edge_agent.sources.source import Counts, Tap, TimedEvent
from edge_agent.sources.velodyne import VelodyneDecoder
from splitslam.errors import DataError, InputError
from splitslam.logs import fields
from splitslam.robot import Robot
from splitslam.scan import ImuSamples, Scan, WheelSamples

_log = logging.getLogger(__name__)
_FIRST_SCANS = 5
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
        self.live_offset_ns: int | None = None
        self._bag = bag
        self._name = str(bag.path)
        self._max_scans = max_scans
        self.notes: list[str] = []
        self.counts = Counts()
        self.dropped: Counter[str] = Counter()
        self.start_ns = 0
        self.end_ns = 0
        self.robot, self.topics = self._choose_topics(robot)
        lidar_topic = self.topics["lidar"]
        self.scan_count: int | None = min(bag.count(lidar_topic), max_scans if max_scans is not None else 2**62)
        kind = bag.topics()[lidar_topic]
        self._decoder: CloudDecoder | VelodyneDecoder
        if kind == topics.VELODYNE_SCAN:
            self._decoder = VelodyneDecoder(self.robot.lidar.model)
        else:
            self._decoder = CloudDecoder(self.robot.lidar)
        self.beam_elevations_rad = self._look_at_first_scans()
        if isinstance(self._decoder, CloudDecoder):
            self._decoder.beam_elevations_rad = self.beam_elevations_rad
            self.notes.extend(self._decoder.notes)
        self._gate = Gate(self.robot, self.counts.left_out)

    def events(self) -> Iterator[TimedEvent]:
        """(arrival time ns, event) in recording order; closes the recording at its end.

        A message that cannot be used is counted in `dropped` and left out.
        """
        convert = {
            self.topics["lidar"]: self._scan,
            self.topics.get("imu"): self._imu,
            self.topics.get("wheels"): self._wheels,
            self.topics.get("gnss"): messages.gnss_fix,
        }
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
                if is_scan:
                    self.counts.scans_read += 1
                    if self.counts.scans_read == self._max_scans:
                        stop_ns = arrival_ns + (_TAIL_NS if "imu" in self.topics else 0)
                try:
                    if isinstance(message, DataError):
                        raise message
                    event = convert[topic](message)
                except DataError as error:
                    self.dropped[error.reason] += 1
                    level = logging.DEBUG if error.reason == "gnss_no_fix" else logging.WARNING
                    said = fields(topic=topic, reason=error.reason, detail=error.detail)
                    _log.log(level, "message left out", extra=said)
                    continue
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

    def _scan(self, message: Any) -> Scan:
        raw = self._decoder(message)
        self.counts.native_bytes += raw.native_bytes
        scan = self._gate(raw)
        self.counts.read_points += len(scan)
        return scan

    def _imu(self, message: Any) -> ImuSamples:
        self.counts.imu_messages += 1
        assert self.robot.imu is not None
        return messages.imu_samples(message, self.robot.imu.time_offset_ns)

    def _wheels(self, message: Any) -> WheelSamples:
        assert self.robot.wheels is not None
        return messages.wheel_samples(message, self.robot.wheels.time_offset_ns)

    def _choose_topics(self, robot: Robot) -> tuple[Robot, dict[str, str]]:
        there = self._bag.topics()
        chosen: dict[str, str] = {}
        sections: dict[str, Any] = {}
        for sensor in (topics.LIDAR, topics.IMU_SENSOR, topics.WHEELS, topics.GNSS):
            section = getattr(robot, sensor.section)
            if section is None:
                continue
            topic, note = topics.choose(sensor, section.topic, there, self._name)
            if note:
                self.notes.append(note)
            if topic is not None:
                chosen[sensor.section] = topic
                sections[sensor.section] = section.model_copy(update={"topic": topic})
            else:
                sections[sensor.section] = None
        self._bag.check_definitions(set(chosen.values()))
        if "lidar" not in chosen or self._bag.count(chosen["lidar"]) == 0:
            raise InputError(
                f"{self._name}: no scans: expected messages of type sensor_msgs/PointCloud2 or"
                f" velodyne_msgs/VelodyneScan; there are: {topics.listing(there)}"
            )
        if "imu" in chosen and not robot.imu_placed:
            raise InputError(
                f"{self._name}: robot file: T_lidar_imu: must be given: the recording has an IMU on {chosen['imu']}"
                " (or set imu: null)"
            )
        return robot.model_copy(update=sections), chosen

    def _look_at_first_scans(self) -> NDArray[np.float32]:
        """Checks the layout on the first scans and returns the beam elevations."""
        lidar = self.robot.lidar
        known = self._in_robot_file(beams.known_elevations_rad, lidar)
        clouds: list[tuple[NDArray[np.float32], NDArray[np.integer] | None]] = []
        problem: DataError | None = None
        for place, (_, _, message) in enumerate(self._bag.messages({self.topics["lidar"]})):
            if place >= 4 * _FIRST_SCANS or len(clouds) >= (_FIRST_SCANS if known is None else 1):
                break
            try:
                clouds.append(self._peek(message))
            except DataError as error:
                problem = error
        if not clouds:
            raise InputError(f"{self._name}: {self.topics['lidar']}: no usable scan among the first: {problem}")
        rings = [int(ring.max(initial=0)) + 1 for _, ring in clouds if ring is not None]
        if rings and max(rings) > lidar.rings:
            raise InputError(
                f"{self._name}: lidar.rings: {lidar.rings}, but ring numbers go up to {max(rings) - 1};"
                f" expected at least {max(rings)}"
            )
        if known is not None:
            return known
        if rings:
            estimate = beams.estimate_per_ring([(p, r) for p, r in clouds if r is not None], lidar.rings)
            if estimate is None:
                raise InputError(
                    f"{self._name}: lidar.beam_elevations_deg: must be given: the first scans show too few points"
                )
        else:
            estimate = self._in_robot_file(beams.estimate_without_ring, [p for p, _ in clouds], lidar.rings)
        self.notes.append(
            f"lidar: elevations of {lidar.rings} rings estimated from the first {len(clouds)} scans:"
            f" {np.rad2deg(estimate.min()):.2f} to {np.rad2deg(estimate.max()):.2f} deg"
        )
        return estimate

    def _peek(self, message: Any) -> tuple[NDArray[np.float32], NDArray[np.integer] | None]:
        if isinstance(message, DataError):
            raise message
        if isinstance(self._decoder, VelodyneDecoder):
            self._in_robot_file(self._decoder.check, message)
            raw: RawScan = self._decoder(message)
            return raw.points_lidar, raw.ring
        table = read_table(message)
        if table.ring is not None:
            raw = self._decoder(message)
            return raw.points_lidar, raw.ring
        return table.points_lidar, None

    def _in_robot_file(self, function: Any, *arguments: Any) -> Any:
        """Calls `function`; its InputErrors get the recording's name in front."""
        try:
            return function(*arguments)
        except InputError as error:
            raise InputError(f"{self._name}: {error}") from error
