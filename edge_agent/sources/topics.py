"""Which topics of a recording are the robot's sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from splitslam.errors import InputError
from splitslam.robot import AUTO, Robot

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
VELODYNE_SCAN = "velodyne_msgs/msg/VelodyneScan"
IMU = "sensor_msgs/msg/Imu"
NAV_SAT_FIX = "sensor_msgs/msg/NavSatFix"
ODOMETRY = "nav_msgs/msg/Odometry"


@dataclass(frozen=True, slots=True)
class Sensor:
    """One section of the robot file: the message types it takes and the usual topic names, best first.

    only_usual: a topic of another name is not taken, even when it is the only one of its type.
    """

    section: str
    types: tuple[str, ...]
    usual: tuple[str, ...]
    only_usual: bool = False


LIDAR = Sensor(
    "lidar",
    (POINT_CLOUD, VELODYNE_SCAN),
    (
        "points_raw",
        "velodyne_points",
        "velodyne_packets",
        "ouster/points",
        "os_cloud_node/points",
        "os1_cloud_node/points",
        "hesai/pandar",
        "pandar_points",
        "lidar_points",
        "rslidar_points",
        "points",
        "lidar/points",
    ),
)
IMU_SENSOR = Sensor(
    "imu",
    (IMU,),
    ("imu_raw", "imu_correct", "imu/data", "imu/data_raw", "imu", "ouster/imu", "os_cloud_node/imu", "microstrain/imu"),
)
WHEELS = Sensor(
    "wheels",
    (ODOMETRY,),
    (
        "wheel/odom",
        "wheel_odom",
        "wheel/odometry",
        "wheel_odometry",
        "wheels/odom",
        "odometry/wheel",
        "odom/wheel",
        "diff_drive_controller/odom",
        "diff_cont/odom",
        "odom_raw",
        "odom",
        "odometry",
    ),
    only_usual=True,  # Odometry is also what every SLAM and every filter publishes
)
GNSS = Sensor("gnss", (NAV_SAT_FIX,), ("gps/fix", "gnss/fix", "fix", "navsat/fix", "ublox/fix", "gps"))


def choose(
    sensor: Sensor, wanted: str | None, topics: dict[str, str], name: str, inside: str = "/"
) -> tuple[str | None, str | None]:
    """The sensor's topic in a recording, and a line to print when it was not named in the robot file.

    wanted: the robot file's topic, AUTO, or None (no such sensor). topics: topic -> type. name: the recording.
    inside: the namespace in which one that is not named is looked for.
    Raises InputError when a named topic is missing or of another type, or when it is not clear which one to take.
    """
    if wanted is None:
        return None, None
    bare = {topic.lstrip("/"): topic for topic in topics}
    if wanted != AUTO:
        found = wanted if wanted in topics else bare.get(wanted.lstrip("/"))
        if found is None:
            raise InputError(f"{name}: {sensor.section}.topic: no topic {wanted}; there are: {listing(topics)}")
        if topics[found] not in sensor.types:
            expected = " or ".join(short(t) for t in sensor.types)
            raise InputError(
                f"{name}: {sensor.section}.topic: {found} is {short(topics[found])}, expected {expected};"
                f" there are: {listing(topics)}"
            )
        return found, None
    fitting = [
        topic for topic, kind in topics.items() if kind in sensor.types and (inside == "/" or topic.startswith(inside))
    ]
    inner = {topic.removeprefix(inside).lstrip("/"): topic for topic in fitting}
    for usual in sensor.usual:
        if usual in inner:
            return inner[usual], f"{sensor.section}: topic {inner[usual]} (usual name; set {sensor.section}.topic)"
    if len(fitting) == 1 and not sensor.only_usual:
        return fitting[0], f"{sensor.section}: topic {fitting[0]} (the only one of its type)"
    if fitting:
        raise InputError(f"{name}: {sensor.section}.topic: must be given, one of: {', '.join(fitting)}")
    return None, f"{sensor.section}: none in the recording"


@dataclass(frozen=True, slots=True)
class Choice:
    """Which topic is which sensor. robot: its file with the topics filled in, imu, wheels and gnss None when not there.

    chosen: section -> topic. notes: lines to print.
    """

    robot: Robot
    chosen: dict[str, str]
    notes: list[str]


def choose_all(robot: Robot, topics: dict[str, str], name: str, inside: str = "/") -> Choice:
    """Every sensor of the robot file. Raises InputError as `choose` does; a LiDAR may be missing in what it returns."""
    chosen: dict[str, str] = {}
    notes: list[str] = []
    sections: dict[str, Any] = {}
    for sensor in (LIDAR, IMU_SENSOR, WHEELS, GNSS):
        section = getattr(robot, sensor.section)
        if section is None:
            continue
        topic, note = choose(sensor, section.topic, topics, name, inside)
        if note:
            notes.append(note)
        if topic is not None:
            chosen[sensor.section] = topic
        sections[sensor.section] = section.model_copy(update={"topic": topic}) if topic is not None else None
    return Choice(robot.model_copy(update=sections), chosen, notes)


def short(msgtype: str) -> str:
    """`sensor_msgs/msg/Imu` -> `sensor_msgs/Imu`."""
    return msgtype.replace("/msg/", "/")


def listing(topics: dict[str, str]) -> str:
    """All topics with their types, one line."""
    return ", ".join(f"{topic} ({short(kind)})" for topic, kind in topics.items()) or "none"
