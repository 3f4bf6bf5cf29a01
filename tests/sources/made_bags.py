"""Small recordings written by the tests with rosbags' own writers, and the messages in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

ROS1, SQLITE3, MCAP = "ros1", "sqlite3", "mcap"
CLOUD, IMU, FIX = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
ODOMETRY = "nav_msgs/msg/Odometry"
T0_NS = 1_700_000_000_000_000_123  # an epoch that a float32 and a float64 both round
_GEOMETRY = ("Vector3", "Point", "Quaternion", "Pose", "Twist", "PoseWithCovariance", "TwistWithCovariance")
_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}

Message = tuple[str, str, int, dict[str, Any]]  # topic, type, arrival ns, fields


def write_bag(folder: Path, kind: str, messages: list[Message]) -> Path:
    """Writes the messages in the order given; returns what a reader opens."""
    path = folder / ("made.bag" if kind == ROS1 else "made")
    store = get_typestore(Stores.ROS1_NOETIC if kind == ROS1 else Stores.ROS2_HUMBLE)
    if kind == ROS1:
        writer: Any = Writer1(path)
    else:
        writer = Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP if kind == MCAP else StoragePlugin.SQLITE3)
    with writer:
        connections: dict[str, Any] = {}
        for topic, msgtype, arrival_ns, fields in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=store)
            message = build(store, msgtype, fields, kind == ROS1)
            raw = store.serialize_ros1(message, msgtype) if kind == ROS1 else store.serialize_cdr(message, msgtype)
            writer.write(connections[topic], arrival_ns, raw)
    return path


def cloud(
    points: np.ndarray,
    stamp_ns: int,
    *,
    topic: str = "/points_raw",
    big_endian: bool = False,
    height: int = 1,
    row_padding: int = 0,
    arrival_ns: int | None = None,
) -> Message:
    """PointCloud2 out of a structured array (its own offsets and itemsize are kept); rows are padded if asked."""
    dtype = points.dtype
    assert dtype.fields is not None
    if big_endian:
        swapped = np.dtype(
            {
                "names": list(dtype.fields),
                "formats": [kind.newbyteorder(">") for kind, *_ in dtype.fields.values()],
                "offsets": [entry[1] for entry in dtype.fields.values()],
                "itemsize": dtype.itemsize,
            }
        )
        points = points.astype(swapped)
    width = len(points) // height
    row_step = width * dtype.itemsize + row_padding
    data = np.full((height, row_step), 0xAB, dtype=np.uint8)
    data[:, : width * dtype.itemsize] = np.frombuffer(points.tobytes(), np.uint8).reshape(height, -1)
    fields = {
        "header": stamp_ns,
        "height": height,
        "width": width,
        "fields": [(name, entry[1], _CODES[entry[0].str[1:]]) for name, entry in dtype.fields.items()],
        "is_bigendian": big_endian,
        "point_step": dtype.itemsize,
        "row_step": row_step,
        "data": data.reshape(-1),
        "is_dense": False,
    }
    return topic, CLOUD, stamp_ns + 100_000_000 if arrival_ns is None else arrival_ns, fields


def imu(
    stamp_ns: int, *, topic: str = "/imu_raw", gyro: tuple = (0.1, 0.2, 0.3), accel: tuple = (0.0, 0.0, 9.8)
) -> Message:
    """One Imu message."""
    return topic, IMU, stamp_ns, {"header": stamp_ns, "gyro": gyro, "accel": accel}


def wheels(
    stamp_ns: int, *, topic: str = "/wheel/odom", velocity: tuple = (1.2, 0.1, 0.0), yaw_rate: float = 0.3
) -> Message:
    """One Odometry message; its pose is far off, as wheels' poses are."""
    return topic, ODOMETRY, stamp_ns, {"header": stamp_ns, "velocity": velocity, "yaw_rate": yaw_rate}


def fix(
    stamp_ns: int, *, topic: str = "/gps/fix", status: int = 0, covariance_type: int = 2, latitude: float = 48.0
) -> Message:
    """One NavSatFix with 0.5 m, 0.6 m and 1 m of standard deviation."""
    fields = {"header": stamp_ns, "status": status, "covariance_type": covariance_type, "latitude": latitude}
    return topic, FIX, stamp_ns, fields


def turn(n_columns: int = 100, elevations_deg: tuple[float, ...] = (-10.0, 0.0, 10.0), range_m: float = 10.0) -> Any:
    """One clockwise turn, firing by firing: (xyz (N, 3) float32, ring (N,), fraction of the turn (N,))."""
    column, ring = np.divmod(np.arange(n_columns * len(elevations_deg)), len(elevations_deg))
    azimuth = -2 * np.pi * column / n_columns
    elevation = np.deg2rad(np.array(elevations_deg))[ring]
    xyz = range_m * np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )
    return xyz.astype(np.float32), ring, column / n_columns


def structured(xyz: np.ndarray, layout: list[tuple[str, str, int]], itemsize: int, **values: Any) -> np.ndarray:
    """Points as structured array: layout of (name, format, offset); x y z from `xyz`, the rest from `values`."""
    dtype = np.dtype(
        {
            "names": [name for name, _, _ in layout],
            "formats": [kind for _, kind, _ in layout],
            "offsets": [offset for _, _, offset in layout],
            "itemsize": itemsize,
        }
    )
    points = np.zeros(len(xyz), dtype=dtype)
    for axis, name in enumerate("xyz"):
        points[name] = xyz[:, axis]
    for name, column in values.items():
        points[name] = column
    return points


VELODYNE = [
    ("x", "<f4", 0),
    ("y", "<f4", 4),
    ("z", "<f4", 8),
    ("intensity", "<f4", 12),
    ("ring", "<u2", 16),
    ("time", "<f4", 18),
]
OUSTER = [
    ("x", "<f4", 0),
    ("y", "<f4", 4),
    ("z", "<f4", 8),
    ("intensity", "<f4", 16),
    ("t", "<u4", 20),
    ("reflectivity", "<u2", 24),
    ("ring", "<u1", 26),
    ("ambient", "<u2", 28),
    ("range", "<u4", 32),
]
HESAI = [
    ("x", "<f4", 0),
    ("y", "<f4", 4),
    ("z", "<f4", 8),
    ("intensity", "<f4", 16),
    ("timestamp", "<f8", 24),
    ("ring", "<u2", 32),
]
PLAIN = [("x", "<f4", 0), ("y", "<f4", 4), ("z", "<f4", 8)]


def build(store: Any, msgtype: str, fields: dict[str, Any], ros1: bool) -> Any:
    """A record of the store's types."""
    types = store.types
    header = _header(types, fields["header"], ros1)
    if msgtype == CLOUD:
        point_fields = [types["sensor_msgs/msg/PointField"](n, o, k, 1) for n, o, k in fields["fields"]]
        return types[CLOUD](**{**fields, "header": header, "fields": point_fields})
    if msgtype == IMU:
        vector, nine = types["geometry_msgs/msg/Vector3"], np.zeros(9)
        rotation = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        return types[IMU](header, rotation, nine, vector(*fields["gyro"]), nine, vector(*fields["accel"]), nine)
    if msgtype == ODOMETRY:
        geometry = {name: types[f"geometry_msgs/msg/{name}"] for name in _GEOMETRY}
        vector = geometry["Vector3"]
        place = geometry["Pose"](geometry["Point"](99.0, 99.0, 99.0), geometry["Quaternion"](0.0, 0.0, 0.0, 1.0))
        twist = geometry["Twist"](vector(*fields["velocity"]), vector(0.0, 0.0, fields["yaw_rate"]))
        pose = geometry["PoseWithCovariance"](place, np.zeros(36))
        return types[ODOMETRY](header, "base_link", pose, geometry["TwistWithCovariance"](twist, np.zeros(36)))
    assert msgtype == FIX
    status = types["sensor_msgs/msg/NavSatStatus"](status=fields["status"], service=1)
    covariance = np.diag([0.25, 0.36, 1.0]).reshape(-1)
    return types[FIX](header, status, fields["latitude"], 11.0, 500.0, covariance, fields["covariance_type"])


def _header(types: Any, stamp_ns: int, ros1: bool) -> Any:
    stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    if ros1:
        return types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="")
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
