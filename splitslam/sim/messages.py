"""Sensor data as ROS 1 messages, each stream in order of arrival at the recorder."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from splitslam.scan import GnssFix, ImuSamples, Scan
from splitslam.sim.lidar import Sweep, packets
from splitslam.sim.spec import DriveSpec, WheelSpec
from splitslam.sim.wheels import WheelSamples

SCAN, CLOUD, IMU, FIX, ODOMETRY = (
    "velodyne_msgs/msg/VelodyneScan",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "nav_msgs/msg/Odometry",
)
_PACKET = "velodyne_msgs/msg/VelodynePacket"
# As Ouster's driver lays out a point, without what nobody reads.
_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4"), ("intensity", "u1"), ("ring", "u1")])
_FIELD_KINDS = {"<f4": 7, "<u4": 6, "|u1": 2}  # of sensor_msgs/PointField
_SCAN_DELAY_NS = 1_000_000  # from the last firing to the recorder
_IMU_DELAY_NS = 200_000
_WHEELS_DELAY_NS = 4_000_000
_GNSS_DELAY_NS = 80_000_000

Message = tuple[int, Any]  # arrival time ns, message


def typestore() -> Typestore:
    """ROS 1's messages and the Velodyne driver's."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("time stamp\nuint8[1206] data\n", _PACKET))
    store.register(get_types_from_msg("std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n", SCAN))
    return store


class Messages:
    """Makes messages of the types of a store."""

    def __init__(self, types: dict[str, Any]) -> None:
        self._types = types

    def scans(self, spec: DriveSpec, sweeps: Iterable[Sweep]) -> Iterator[Message]:
        for n, sweep in enumerate(sweeps):
            sent = [
                self._types[_PACKET](stamp=self._time(stamp_ns), data=np.frombuffer(data, np.uint8))
                for stamp_ns, data in packets(sweep, spec.lidar.rate_hz, spec.start_ns)
            ]
            header = self._header(n, spec.start_ns + sweep.first_ns, "velodyne")
            arrival_ns = spec.start_ns + sweep.last_ns + _SCAN_DELAY_NS
            yield arrival_ns, self._types[SCAN](header=header, packets=sent)

    def clouds(self, sweeps: Iterable[Scan]) -> Iterator[Message]:
        fields = [
            self._types["sensor_msgs/msg/PointField"](
                name=name, offset=offset, datatype=_FIELD_KINDS[kind.str], count=1
            )
            for name, (kind, offset, *_) in (_POINT.fields or {}).items()
        ]
        for n, scan in enumerate(sweeps):
            points = np.empty(len(scan), _POINT)
            for axis, name in enumerate("xyz"):
                points[name] = scan.points_lidar[:, axis]
            points["t"], points["intensity"], points["ring"] = scan.t_offset_ns, scan.intensity, scan.ring
            message = self._types[CLOUD](
                header=self._header(n, scan.stamp_ns, "lidar"),
                height=1,
                width=len(points),
                fields=fields,
                is_bigendian=False,
                point_step=_POINT.itemsize,
                row_step=points.nbytes,
                data=points.view(np.uint8).reshape(-1),
                is_dense=True,
            )
            yield scan.end_ns + _SCAN_DELAY_NS, message

    def imu(self, samples: ImuSamples) -> Iterator[Message]:
        vector, quaternion = (self._types[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Quaternion"))
        nowhere = quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
        unknown, no_orientation = np.zeros(9), np.array([-1.0] + [0.0] * 8)  # -1: no such estimate (sensor_msgs/Imu)
        rows = zip(samples.stamps_ns.tolist(), samples.gyro_radps.tolist(), samples.accel_mps2.tolist(), strict=True)
        for n, (stamp_ns, gyro, accel) in enumerate(rows):
            message = self._types[IMU](
                header=self._header(n, stamp_ns, "imu_link"),
                orientation=nowhere,
                orientation_covariance=no_orientation,
                angular_velocity=vector(x=gyro[0], y=gyro[1], z=gyro[2]),
                angular_velocity_covariance=unknown,
                linear_acceleration=vector(x=accel[0], y=accel[1], z=accel[2]),
                linear_acceleration_covariance=unknown,
            )
            yield stamp_ns + _IMU_DELAY_NS, message

    def fixes(self, fixes: list[GnssFix]) -> Iterator[Message]:
        for n, fix in enumerate(fixes):
            assert fix.covariance_enu_m2 is not None
            message = self._types[FIX](
                header=self._header(n, fix.stamp_ns, "gps"),
                status=self._types["sensor_msgs/msg/NavSatStatus"](status=fix.status, service=1),
                latitude=fix.latitude_deg,
                longitude=fix.longitude_deg,
                altitude=fix.altitude_m,
                position_covariance=fix.covariance_enu_m2.ravel(),
                position_covariance_type=2,
            )
            yield fix.stamp_ns + _GNSS_DELAY_NS, message

    def wheels(self, spec: WheelSpec, samples: WheelSamples) -> Iterator[Message]:
        point, vector, quaternion = (self._types[f"geometry_msgs/msg/{k}"] for k in ("Point", "Vector3", "Quaternion"))
        sigma = np.array([spec.speed_noise_mps, 1e3, 1e3, 1e3, 1e3, spec.yaw_rate_noise_radps])  # 1e3: not measured
        poses, twist_covariance = samples.pose.tolist(), np.diag(sigma**2).ravel()
        rows = zip(samples.stamps_ns.tolist(), samples.speed_mps.tolist(), samples.yaw_rate_radps.tolist(), strict=True)
        for n, (stamp_ns, speed, yaw_rate) in enumerate(rows):
            x, y, yaw = poses[n]
            turned = quaternion(x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))
            twist = self._types["geometry_msgs/msg/Twist"](
                linear=vector(x=speed, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=yaw_rate)
            )
            pose = self._types["geometry_msgs/msg/Pose"](position=point(x=x, y=y, z=0.0), orientation=turned)
            message = self._types[ODOMETRY](
                header=self._header(n, stamp_ns, "wheel_odom"),
                child_frame_id="base_link",
                pose=self._types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
                twist=self._types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=twist_covariance),
            )
            yield stamp_ns + _WHEELS_DELAY_NS, message

    def _header(self, seq: int, stamp_ns: int, frame: str) -> Any:
        return self._types["std_msgs/msg/Header"](seq=seq, stamp=self._time(stamp_ns), frame_id=frame)

    def _time(self, stamp_ns: int) -> Any:
        return self._types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
