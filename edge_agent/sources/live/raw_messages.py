"""Live readings as ROS 2 messages for the raw ring: what `splitslam diagnose` makes of them, `splitslam run` reads.

A Velodyne's turn keeps its packets, so that it is decoded again to the same points. An Ouster's becomes a point cloud.
Stamps that a ROS message cannot hold, beyond 2038, are not kept: a sensor's clock must not end a run.
"""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_agent.raw_ring import RawStream
from edge_agent.sources.bag import typestore
from edge_agent.sources.live.turns import Packet
from edge_agent.sources.source import Event, Tap
from splitslam.logs import fields
from splitslam.scan import GnssFix, ImuSamples, Scan

_log = logging.getLogger(__name__)

LIDAR_FRAME, IMU_FRAME, GNSS_FRAME = "lidar", "imu", "gnss"
_CLOUD = "sensor_msgs/msg/PointCloud2"
_TURN = "velodyne_msgs/msg/VelodyneScan"
_IMU = "sensor_msgs/msg/Imu"
_FIX = "sensor_msgs/msg/NavSatFix"
CLOUD_TOPIC, TURN_TOPIC, IMU_TOPIC, FIX_TOPIC = "/points", "/velodyne_packets", "/imu/data", "/gps/fix"

_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4"), ("ring", "<u2")])
_DATATYPES = {"<f4": 7, "<u4": 6, "<u2": 4}  # sensor_msgs/PointField
_UNKNOWN = np.zeros(9)
_END_NS = (2**31 - 60) * 1_000_000_000  # builtin_interfaces/Time: int32 seconds; a message's stamps lie within seconds


class RawMessages:
    """Writes events to a tap."""

    def __init__(self, tap: Tap) -> None:
        self._tap = tap
        self._store = typestore()
        self._told = False  # that stamps are beyond what a message holds
        self._streams = {
            kind: RawStream(topic, kind, "cdr")
            for topic, kind in ((CLOUD_TOPIC, _CLOUD), (TURN_TOPIC, _TURN), (IMU_TOPIC, _IMU), (FIX_TOPIC, _FIX))
        }

    def put(self, arrival_ns: int, event: Event, packets: tuple[Packet, ...], offset_ns: int) -> None:
        """One event in the run's time; offset_ns: from the sensor's clock, which packets are in, to it."""
        stamp_ns = int(event.stamp_ns if isinstance(event, Scan | GnssFix) else event.stamps_ns[-1])
        if not 0 <= stamp_ns < _END_NS:
            if not self._told:
                _log.error(
                    "raw messages not kept", extra=fields(detail=f"stamp {stamp_ns} ns: ROS has 31 bits of seconds")
                )
            self._told = True
            return
        if isinstance(event, Scan):
            if packets:
                self._write(_TURN, arrival_ns, self._turn(event, packets, offset_ns))
            else:
                self._write(_CLOUD, arrival_ns, self._cloud(event))
        elif isinstance(event, ImuSamples):
            for k in range(len(event)):
                self._write(_IMU, arrival_ns, self._imu(event, k))
        elif isinstance(event, GnssFix):
            self._write(_FIX, arrival_ns, self._fix(event))

    def _write(self, kind: str, arrival_ns: int, message: Any) -> None:
        self._tap(self._streams[kind], arrival_ns, bytes(self._store.serialize_cdr(message, kind)))

    def _make(self, kind: str, *values: Any) -> Any:
        return self._store.types[kind](*values)

    def _header(self, stamp_ns: int, frame: str) -> Any:
        return self._make("std_msgs/msg/Header", self._time(stamp_ns), frame)

    def _time(self, stamp_ns: int) -> Any:
        return self._make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 1_000_000_000))

    def _turn(self, scan: Scan, packets: tuple[Packet, ...], offset_ns: int) -> Any:
        made = [
            self._make(
                "velodyne_msgs/msg/VelodynePacket",
                self._time(packet.sensor_ns + offset_ns),
                np.frombuffer(packet.data, dtype=np.uint8),
            )
            for packet in packets
        ]
        return self._make(_TURN, self._header(scan.stamp_ns, LIDAR_FRAME), made)

    def _cloud(self, scan: Scan) -> Any:
        points = np.empty(len(scan), dtype=_POINT)
        for axis, name in enumerate("xyz"):
            points[name] = scan.points_lidar[:, axis]
        points["intensity"], points["t"], points["ring"] = scan.intensity, scan.t_offset_ns, scan.ring
        fields = [
            self._make("sensor_msgs/msg/PointField", name, offset, _DATATYPES[kind.str], 1)
            for name, (kind, offset, *_) in (_POINT.fields or {}).items()
        ]
        header = self._header(scan.stamp_ns, LIDAR_FRAME)
        size = points.itemsize
        data = points.view(np.uint8).reshape(-1)
        return self._make(_CLOUD, header, 1, len(points), fields, False, size, size * len(points), data, True)

    def _imu(self, samples: ImuSamples, k: int) -> Any:
        header = self._header(int(samples.stamps_ns[k]), IMU_FRAME)
        no_orientation = np.array([-1.0, *_UNKNOWN[1:]])
        level = self._make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        gyro, accel = self._vector(samples.gyro_radps[k]), self._vector(samples.accel_mps2[k])
        return self._make(_IMU, header, level, no_orientation, gyro, _UNKNOWN, accel, _UNKNOWN)

    def _vector(self, values: NDArray[np.float64]) -> Any:
        return self._make("geometry_msgs/msg/Vector3", *(float(value) for value in values))

    def _fix(self, fix: GnssFix) -> Any:
        status = self._make("sensor_msgs/msg/NavSatStatus", fix.status, 1)
        known = fix.covariance_enu_m2 is not None
        covariance = fix.covariance_enu_m2.reshape(-1) if fix.covariance_enu_m2 is not None else _UNKNOWN
        place = (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
        return self._make(_FIX, self._header(fix.stamp_ns, GNSS_FRAME), status, *place, covariance, 2 if known else 0)
