"""Messages on the robot's sensor topics -> events: the same for recordings, ROS 1 and ROS 2."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_agent.sources import beams, messages, topics
from edge_agent.sources.cloud_decoder import CloudDecoder
from edge_agent.sources.pointcloud2 import read_table
from edge_agent.sources.raw import Gate, RawScan
from edge_agent.sources.source import Counts, Event
from edge_agent.sources.velodyne import VelodyneDecoder
from splitslam.errors import DataError, InputError
from splitslam.logs import fields
from splitslam.robot import Robot
from splitslam.scan import ImuSamples, Scan, WheelSamples

_log = logging.getLogger(__name__)
_FIRST_SCANS = 5


class Decoding:
    """One pass over the messages of one robot; `look_at` first, then `event` for each.

    robot, chosen: as `topics.choose_all` has them. lidar_type: of the LiDAR's topic. name: the source, for errors.
    dropped: where others count as well. counts, dropped, notes, beam_elevations_rad: as in Source.
    """

    def __init__(
        self,
        robot: Robot,
        chosen: dict[str, str],
        lidar_type: str,
        name: str,
        dropped: Counter[str] | None = None,
    ) -> None:
        self._robot, self._name = robot, name
        self._lidar_topic = chosen["lidar"]
        self.counts = Counts()
        self.dropped: Counter[str] = Counter() if dropped is None else dropped
        self.notes: list[str] = []
        self.beam_elevations_rad: NDArray[np.float32] = np.empty(0, np.float32)
        self._decoder: CloudDecoder | VelodyneDecoder
        if lidar_type == topics.VELODYNE_SCAN:
            self._decoder = VelodyneDecoder(robot.lidar.model)
        else:
            self._decoder = CloudDecoder(robot.lidar)
        self._gate = Gate(robot, self.counts.left_out)
        self._convert = {
            chosen["lidar"]: self._scan,
            chosen.get("imu"): self._imu,
            chosen.get("wheels"): self._wheels,
            chosen.get("gnss"): messages.gnss_fix,
        }

    def event(self, topic: str, message: Any) -> Event | None:
        """One message (or the DataError that parsing it ended with) -> its event.

        None for one that cannot be used: it is counted in `dropped`.
        """
        self.counts.scans_read += topic == self._lidar_topic
        try:
            if isinstance(message, DataError):
                raise message
            return self._convert[topic](message)
        except DataError as error:
            self.dropped[error.reason] += 1
            level = logging.DEBUG if error.reason == "gnss_no_fix" else logging.WARNING
            said = fields(topic=topic, reason=error.reason, detail=error.detail)
            _log.log(level, "message left out", extra=said)
            return None

    def _scan(self, message: Any) -> Scan:
        raw = self._decoder(message)
        self.counts.native_bytes += raw.native_bytes
        scan = self._gate(raw)
        self.counts.read_points += len(scan)
        return scan

    def _imu(self, message: Any) -> ImuSamples:
        self.counts.imu_messages += 1
        assert self._robot.imu is not None
        return messages.imu_samples(message, self._robot.imu.time_offset_ns)

    def _wheels(self, message: Any) -> WheelSamples:
        assert self._robot.wheels is not None
        return messages.wheel_samples(message, self._robot.wheels.time_offset_ns)

    # --- the first scans ----------------------------------------------------------------------------------------

    def look_at(self, first: Iterable[Any]) -> None:
        """Checks the layout on the LiDAR's first messages, no more of them than it needs, and finds the beams.

        Raises InputError when the robot file does not fit (model, rings), or no usable scan is among them.
        """
        self.beam_elevations_rad = self._beams(first)
        if isinstance(self._decoder, CloudDecoder):
            self._decoder.beam_elevations_rad = self.beam_elevations_rad
            self.notes.extend(self._decoder.notes)

    def _beams(self, first: Iterable[Any]) -> NDArray[np.float32]:
        lidar = self._robot.lidar
        known = self._in_robot_file(beams.known_elevations_rad, lidar)
        wanted = _FIRST_SCANS if known is None else 1
        clouds: list[tuple[NDArray[np.float32], NDArray[np.integer] | None]] = []
        problem: DataError | None = None
        for place, message in enumerate(first, 1):
            try:
                clouds.append(self._peek(message))
            except DataError as error:
                problem = error
            if len(clouds) == wanted or place == 4 * _FIRST_SCANS:
                break
        if not clouds:
            raise InputError(f"{self._name}: {self._lidar_topic}: no usable scan among the first: {problem}")
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
        """Calls `function`; its InputErrors get the source's name in front."""
        try:
            return function(*arguments)
        except InputError as error:
            raise InputError(f"{self._name}: {error}") from error
