"""Gauges by robot, for those who want one series a robot: at most so many robots, and none whose session has gone."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from prometheus_client import CollectorRegistry
from prometheus_client.metrics_core import GaugeMetricFamily
from prometheus_client.registry import Collector

from map_service import robot_metric_list as m
from map_service.channel import RobotStanding
from splitslam.metrics import Metric


@dataclass(frozen=True, slots=True)
class RobotSeen:
    """The same with what the front knows. answered_s: when its last frame was answered; NaN: none yet."""

    standing: RobotStanding
    waiting_frames: int = 0
    answered_s: float = math.nan


_GAUGES: tuple[tuple[Metric, Callable[[RobotSeen, float], float]], ...] = (
    (m.STATE, lambda robot, _: 0 if robot.standing.stream is None else robot.standing.state),
    (m.ANSWER_AGE, lambda robot, now_s: now_s - robot.answered_s),
    (m.QUEUE, lambda robot, _: robot.waiting_frames),
    (m.BACKLOG, lambda robot, _: robot.standing.backlog_frames),
    (m.SCANS, lambda robot, _: robot.standing.scans),
    (m.SESSION_AGE, lambda robot, now_s: now_s - robot.standing.opened_s),
    (m.UNDURABLE, lambda robot, _: robot.standing.undurable_frames),
    (m.POSITION_SIGMA, lambda robot, _: robot.standing.position_sigma_m),
    (m.ROTATION_SIGMA, lambda robot, _: robot.standing.rotation_sigma_rad),
)


class RobotGauges(Collector):
    """A robot that has a series keeps it while it has a session here; who comes when all are taken is only counted."""

    def __init__(self, most: int, registry: CollectorRegistry) -> None:
        self._most = most
        self._by_worker: dict[int, list[RobotSeen]] = {}
        self._shown: dict[str, RobotSeen] = {}  # in the order in which they came; made anew, read by the page's thread
        self._more = 0
        registry.register(self)

    def update(self, worker: int, robots: list[RobotSeen]) -> None:
        """All sessions of a worker as they stand now."""
        self._by_worker[worker] = robots
        newest = self._newest()
        shown = dict.fromkeys([*(robot_id for robot_id in self._shown if robot_id in newest), *newest])
        self._shown = {robot_id: newest[robot_id] for robot_id in list(shown)[: self._most]}
        self._more = len(newest) - len(self._shown)

    def describe(self) -> Iterator[GaugeMetricFamily]:
        yield from (_family(metric) for metric in m.ROBOT_METRICS)

    def collect(self) -> Iterator[GaugeMetricFamily]:
        shown, now_s = self._shown, time.monotonic()
        for metric, value in _GAUGES:
            family = _family(metric)
            for robot_id, robot in shown.items():
                family.add_metric([robot_id], value(robot, now_s))
            yield family
        more = _family(m.NOT_SHOWN)
        more.add_metric([], self._more)
        yield more

    def _newest(self) -> dict[str, RobotSeen]:
        """One session for each robot: the one with the newest scan, when frames of a run before are sent beside it."""
        newest: dict[str, RobotSeen] = {}
        for robot in [robot for robots in self._by_worker.values() for robot in robots]:
            other = newest.get(robot.standing.robot_id)
            if other is None or robot.standing.last_stamp_ns >= other.standing.last_stamp_ns:
                newest[robot.standing.robot_id] = robot
        return newest


def _family(metric: Metric) -> GaugeMetricFamily:
    return GaugeMetricFamily(metric.name, metric.text, labels=metric.label_names)
