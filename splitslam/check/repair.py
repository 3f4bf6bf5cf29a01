"""Makes a robot file fit a recording as far as it can, so that one mistake does not hide the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from edge_agent.sources import topics
from edge_agent.sources.bag import Bag
from edge_agent.sources.pointcloud2 import read_table
from edge_agent.sources.velodyne import SENSOR_OF_CODE
from splitslam.check.findings import Finding, note
from splitslam.errors import DataError, InputError
from splitslam.robot import AUTO, Lidar, Robot

_FIRST_SCANS = 5
_THERE = "there are: "


def repaired(path: Path, robot: Robot) -> tuple[Robot, list[Finding]]:
    """The robot file with topics, model, rings and T_lidar_imu that can be used, and a line for each change.

    Raises InputError when the recording cannot be read or holds no LiDAR at all.
    """
    findings: list[Finding] = []
    with Bag(path) as bag:
        robot = _topics(bag, robot, findings)
        if robot.imu is not None and not robot.imu_placed:
            findings.append(Finding("T_lidar_imu", "not given", "T_lidar_imu: p_lidar = T_lidar_imu @ p_imu"))
            robot = robot.model_copy(update={"T_lidar_imu": np.eye(4)})
        robot = _lidar(bag, robot, findings)
    return robot, findings


def _topics(bag: Bag, robot: Robot, findings: list[Finding]) -> Robot:
    sections: dict[str, Any] = {}
    for sensor in (topics.LIDAR, topics.IMU_SENSOR, topics.WHEELS, topics.GNSS):
        section = getattr(robot, sensor.section)
        if section is None and sensor is topics.WHEELS:
            continue  # Odometry is also what every filter publishes
        if section is None:
            unused = [topic for topic, kind in bag.topics().items() if kind in sensor.types]
            findings += [note(sensor.section, f"none in the robot file, but there is {unused[0]}")] if unused else []
            continue
        chosen = _topic(bag, sensor, section.topic, findings)
        sections[sensor.section] = None if chosen is None else section.model_copy(update={"topic": chosen})
    if sections["lidar"] is None:
        listing = topics.listing(bag.topics())
        raise InputError(f"{bag.path}: no LiDAR topic that can be used; there are: {listing}")
    return robot.model_copy(update=sections)


def _topic(bag: Bag, sensor: topics.Sensor, wanted: str, findings: list[Finding]) -> str | None:
    """The topic named, or the one it could have meant."""
    there, name = bag.topics(), str(bag.path)
    try:
        chosen, _ = topics.choose(sensor, wanted, there, name)
        if chosen is None and sensor is topics.IMU_SENSOR:
            findings.append(Finding("imu", "none in the recording", topics.short(topics.IMU)))
        return chosen
    except InputError as error:
        findings.append(as_finding(error, path=bag.path))
    chosen = None if wanted == AUTO else _other_topic(sensor, there, name)
    if chosen is not None:
        findings.append(note(f"{sensor.section}.topic", f"{chosen} is looked at instead"))
    return chosen


def _other_topic(sensor: topics.Sensor, there: dict[str, str], name: str) -> str | None:
    try:
        return topics.choose(sensor, AUTO, there, name)[0]
    except InputError:
        return None


def _lidar(bag: Bag, robot: Robot, findings: list[Finding]) -> Robot:
    """Model and rings as the messages show them."""
    lidar = robot.lidar
    model, rings = _what_comes(bag, lidar.topic)
    if model is not None and model != lidar.model:
        findings.append(Finding("lidar.model", f"{lidar.model}, but packets come from a {model}", model))
        return robot.model_copy(update={"lidar": _as_model(lidar, model)})
    if rings is not None and rings > lidar.rings:
        findings.append(
            Finding("lidar.rings", f"{lidar.rings}, but ring numbers go up to {rings - 1}", f"at least {rings}")
        )
        changed = {"rings": rings, "model": "generic", "beam_elevations_deg": None}
        return robot.model_copy(update={"lidar": lidar.model_copy(update=changed)})
    return robot


def _as_model(lidar: Lidar, model: str) -> Lidar:
    kept = lidar.model_dump(include={"topic", "stamp", "rate_hz", "min_range_m", "max_range_m", "crop_boxes_body"})
    return Lidar(model=model, **kept)  # type: ignore[arg-type]


def _what_comes(bag: Bag, topic: str) -> tuple[str | None, int | None]:
    """(model by the packets' own code, or None; rings by the points' ring numbers, or None)."""
    packets = bag.topics()[topic] == topics.VELODYNE_SCAN
    rings: int | None = None
    for place, (_, _, message) in enumerate(bag.messages({topic})):
        if place == _FIRST_SCANS:
            break
        if isinstance(message, DataError):
            continue
        if packets:
            if len(message.packets) and len(message.packets[0].data):
                return SENSOR_OF_CODE.get(int(message.packets[0].data[-1])), None
            continue
        try:
            ring = read_table(message).ring
        except DataError:
            continue
        if ring is not None and len(ring):
            rings = max(rings or 0, int(np.nanmax(ring)) + 1)
    return None, rings


def as_finding(error: InputError, path: Path) -> Finding:
    """`recording: key: what; expected this` or `...; there are: these` -> a finding."""
    text = str(error).removeprefix(f"{path}: ")
    where, _, rest = text.partition(": ")
    what, _, expected = rest.partition("; expected ")
    if not expected:
        what, _, expected = rest.replace(", expected ", "; ", 1).partition("; ")
        expected = f"one of {expected[len(_THERE) :]}" if expected.startswith(_THERE) else expected
    return Finding(where, what, expected)
