"""A Source that listens to a ROS graph."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

from edge_agent.raw_ring import RawStream
from edge_agent.ros.codec import TF
from edge_agent.ros.connect import join
from edge_agent.ros.extrinsics import Extrinsics
from edge_agent.ros.graph import SAMPLES, SCANS, STATIC, Graph
from edge_agent.ros.inbox import Inbox, RawMessage
from edge_agent.ros.missing import Missing
from edge_agent.ros.outlets import Outlets
from edge_agent.ros.patience import Patience
from edge_agent.ros.sensors import SensorSearch
from edge_agent.ros.settings import GraphSettings, RosSettings
from edge_agent.ros.tf_buffer import TfBuffer, transform_of
from edge_agent.sources.decoding import Decoding
from edge_agent.sources.messages import stamp_ns
from edge_agent.sources.source import Tap, TimedEvent
from splitslam.errors import DataError, InputError
from splitslam.robot import Robot

_FIRST_SCANS = 20
_STATIC_S = 3.0  # for /tf_static to come, when it is needed
_IDLE_S = 0.2
_SILENT_S = 3.0


def open_ros(settings: GraphSettings, ros: RosSettings, robot: Robot, stop: threading.Event) -> RosSource:
    """Joins the graph and waits for the sensors. InputError (a line) when they do not come, StoppedError on `stop`."""
    graph = join(settings, stop)
    try:
        return RosSource(graph, settings, ros, robot, stop)
    except BaseException:
        graph.close()
        raise


class RosSource:
    """Source: the robot's sensors in a graph. What comes while the agent starts waits, and is not lost.

    outlets: the agent's own topics; None: it publishes nothing. dropped: includes what the middleware says that it has
    lost, and what never came.
    """

    def __init__(
        self, graph: Graph, settings: GraphSettings, ros: RosSettings, robot: Robot, stop: threading.Event
    ) -> None:
        self.graph, self.settings = graph, settings
        self.tap: Tap | None = None
        self.live_offset_ns: int | None = time.time_ns() - time.monotonic_ns()
        self.scan_count: int | None = None
        self.start_ns = self.end_ns = 0
        self.dropped = graph.lost
        self.outlets = Outlets(graph, settings, ros, robot.robot.id) if ros.publish else None
        self._patience = Patience(settings.wait_s, stop, self.outlets.waiting if self.outlets else None)
        sensors = SensorSearch(graph, settings.namespace, robot).wait(self._patience)
        self.topics, self._types = sensors.topics, sensors.types
        self._inbox = Inbox(settings.queue_bytes, self.dropped)
        self._heard_s = dict.fromkeys(self.topics, time.monotonic())
        self._tree = TfBuffer()
        graph.subscribe(f"{ros.tf}_static", TF, STATIC, self._on_static)
        for section, topic in self.topics.items():
            delivery = SCANS if section == "lidar" else SAMPLES
            graph.subscribe(topic, self._types[topic], delivery, lambda raw, at=topic: self._inbox.put(at, raw))
        extrinsics = self._extrinsics(ros.base_frame, sensors.robot)
        self.robot = extrinsics.complete(sensors.robot)
        lidar_type = self._types[self.topics["lidar"]]
        self._decoding = Decoding(self.robot, self.topics, lidar_type, graph.name, self.dropped)
        self._decoding.look_at(self._first_scans())
        self.counts = self._decoding.counts
        self.beam_elevations_rad = self._decoding.beam_elevations_rad
        self.notes = [*sensors.notes, *extrinsics.notes, *self._decoding.notes]
        self._streams: dict[str, RawStream] = {}
        even = {"lidar": "ros_scan_missing", "imu": "ros_imu_missing"}
        self._missing = {t: Missing(even[s], self.dropped) for s, t in self.topics.items() if s in even}

    def events(self) -> Iterator[TimedEvent | None]:
        """As Source says; ends when nothing has come for `end_after_s`."""
        end_after_s = self.settings.end_after_s
        heard_s = time.monotonic()
        while not self._inbox.closed:
            messages = self._inbox.take(_IDLE_S)
            for message in messages:
                event = self._event(message)
                if event is not None:
                    yield event
            now_s = time.monotonic()
            heard_s = now_s if messages else heard_s
            if end_after_s is not None and now_s - heard_s > end_after_s:
                return
            yield None

    def status(self) -> str:
        """Sensors that are silent."""
        now_s = time.monotonic()
        silent = {section: now_s - heard_s for section, heard_s in self._heard_s.items()}
        return ", ".join(f"{section} silent for {s:.0f} s" for section, s in silent.items() if s > _SILENT_S)

    def close(self) -> None:
        """Ends `events` and leaves the graph."""
        self._inbox.close()
        self.graph.close()

    def _event(self, message: RawMessage) -> TimedEvent | None:
        assert self.live_offset_ns is not None
        arrival_ns = message.arrival_ns + self.live_offset_ns
        self.start_ns = self.start_ns or arrival_ns
        self.end_ns = arrival_ns
        for section, topic in self.topics.items():
            if topic == message.topic:
                self._heard_s[section] = message.arrival_ns * 1e-9
        if self.tap is not None:
            self.tap(self._stream(message.topic), arrival_ns, message.raw)
        record = self._decoded(message)
        if message.topic in self._missing and not isinstance(record, DataError):
            self._missing[message.topic].saw(stamp_ns(record.header))
        event = self._decoding.event(message.topic, record)
        return None if event is None else (arrival_ns, event)

    def _decoded(self, message: RawMessage) -> Any:
        """The record, or the DataError that it ended with."""
        try:
            return self.graph.codec.decode(message.raw, self._types[message.topic])
        except DataError as error:
            return error

    def _stream(self, topic: str) -> RawStream:
        if topic not in self._streams:
            self._streams[topic] = self.graph.codec.stream(topic, self._types[topic])
        return self._streams[topic]

    # --- before the first event ---------------------------------------------------------------------------------

    def _first_scans(self) -> Iterator[Any]:
        topic = self.topics["lidar"]
        for count in range(1, _FIRST_SCANS + 1):
            messages = self._first(topic, count, self._patience)
            if len(messages) < count:
                return
            yield self._decoded(messages[-1])

    def _first(self, topic: str, count: int, patience: Patience) -> list[RawMessage]:
        """The first messages on a topic, which stay in the inbox; fewer when they do not come in time."""
        while len(messages := self._inbox.first(topic, count)) < count and not patience.over:
            patience.pause(topic)
        return messages

    def _extrinsics(self, base_frame: str, robot: Robot) -> Extrinsics:
        patience = Patience(_STATIC_S, self._patience.stop)

        def wait() -> bool:
            patience.pause("/tf_static")
            return not patience.over

        return Extrinsics(self._tree, base_frame, self._frames(robot), wait, self.graph.name)

    def _frames(self, robot: Robot) -> dict[str, str]:
        """The frame that each sensor's messages are in, of those that matter."""
        frames: dict[str, str] = {}
        for section in filter(lambda one: _matters(one, robot), self.topics):
            needed = section in ("lidar", "imu")
            patience = self._patience if needed else Patience(_STATIC_S, self._patience.stop)
            for message in self._first(self.topics[section], 1, patience):
                record = self._decoded(message)
                if not isinstance(record, DataError):
                    frames[section] = record.child_frame_id if section == "wheels" else record.header.frame_id
        if "lidar" not in frames:
            raise InputError(f"{self.graph.name}: {self.topics['lidar']}: no scan has come; expected one")
        return frames

    def _on_static(self, raw: bytes) -> None:
        try:
            message = self.graph.codec.decode(raw, TF)
        except DataError:
            self.dropped["decode"] += 1
            return
        for stamped in message.transforms:
            T = transform_of(stamped.transform)
            if T is not None:
                child = stamped.child_frame_id
                self._tree.add(stamped.header.frame_id, child, stamp_ns(stamped.header), T, fixed=True)


def _matters(section: str, robot: Robot) -> bool:
    """The robot file leaves open where the sensor is."""
    if section == "imu":
        return not robot.imu_placed
    if section == "gnss":
        return robot.gnss is not None and "t_lidar_antenna_m" not in robot.gnss.model_fields_set
    if section == "wheels":
        return robot.wheels is not None and "T_body_wheel" not in robot.wheels.model_fields_set
    return True
