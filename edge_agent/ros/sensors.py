"""Which topics of a graph are the robot's sensors: those of a recording are all there, those of a graph turn up."""

from __future__ import annotations

import time
from dataclasses import dataclass

from edge_agent.ros.graph import Graph, in_namespace
from edge_agent.ros.patience import Patience
from edge_agent.sources import topics
from edge_agent.sources.topics import Choice, Sensor
from splitslam.errors import InputError
from splitslam.robot import AUTO, Robot

_SETTLE_S = 2.0  # discovery finds a graph's topics one after the other
_OTHERS = (topics.IMU_SENSOR, topics.WHEELS, topics.GNSS)


@dataclass(frozen=True, slots=True)
class Sensors:
    """robot, topics, notes: as in Source. types: topic -> message type."""

    robot: Robot
    topics: dict[str, str]
    types: dict[str, str]
    notes: list[str]


class SensorSearch:
    """Looks for the sensors of one robot; only the LiDAR has to be there."""

    def __init__(self, graph: Graph, namespace: str, robot: Robot) -> None:
        self._graph, self._inside = graph, f"/{namespace}/" if namespace else "/"
        self._robot = _in_full(robot, namespace)

    def wait(self, patience: Patience) -> Sensors:
        """Raises InputError when there is no LiDAR by then, or no telling which; StoppedError."""
        settled_s: float | None = None
        while True:
            there = self._graph.topics()
            found = {sensor.section: self._find(sensor, there) for sensor in (topics.LIDAR, *_OTHERS)}
            if found["lidar"] is not None or self._is_unclear(there):
                now_s = time.monotonic()
                settled_s = now_s + _SETTLE_S if settled_s is None else settled_s
                missing = [section for section, topic in found.items() if topic is None and self._wants(section)]
                if not missing or now_s > settled_s:
                    return self._chosen(there)
            elif patience.over:
                self._chosen(there)  # a LiDAR that the robot file names is told by its name
                raise InputError(
                    f"{self._graph.name}: no scans: expected a topic of type sensor_msgs/PointCloud2 or"
                    f" velodyne_msgs/VelodyneScan; there are: {topics.listing(there)}"
                )
            patience.pause("lidar")

    def _is_unclear(self, there: dict[str, str]) -> bool:
        """There are LiDARs, and the robot file does not say which."""
        fitting = [topic for topic, kind in there.items() if kind in topics.LIDAR.types]
        return self._robot.lidar.topic == AUTO and any(topic.startswith(self._inside) for topic in fitting)

    def _wants(self, section: str) -> bool:
        return getattr(self._robot, section) is not None

    def _find(self, sensor: Sensor, there: dict[str, str]) -> str | None:
        if not self._wants(sensor.section):
            return None
        wanted = getattr(self._robot, sensor.section).topic
        try:
            return topics.choose(sensor, wanted, there, self._graph.name, self._inside)[0]
        except InputError:
            if wanted in there:
                raise  # of another type: waiting does not help
            return None

    def _chosen(self, there: dict[str, str]) -> Sensors:
        """Named topics that nobody publishes yet are listened to all the same, except for the LiDAR's."""
        robot, notes, known = self._robot, [], dict(there)
        for sensor in _OTHERS:
            section = getattr(robot, sensor.section)
            if section is not None and section.topic != AUTO and section.topic not in known:
                known[section.topic] = sensor.types[0]
                notes.append(f"{sensor.section}: nobody publishes {section.topic} yet")
        choice: Choice = topics.choose_all(robot, known, self._graph.name, self._inside)
        types = {topic: known[topic] for topic in choice.chosen.values()}
        return Sensors(choice.robot, choice.chosen, types, [*notes, *choice.notes])


def _in_full(robot: Robot, namespace: str) -> Robot:
    """The robot with the topics that its file names in full."""
    sections = {}
    for name in ("lidar", "imu", "wheels", "gnss"):
        section = getattr(robot, name)
        if section is not None and section.topic != AUTO:
            sections[name] = section.model_copy(update={"topic": in_namespace(section.topic, namespace)})
    return robot.model_copy(update=sections)
