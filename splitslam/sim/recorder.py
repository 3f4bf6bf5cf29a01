"""Writes a drive as a robot would have recorded it: a ROS 1 bag, its robot file, and the truth beside it."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from splitslam.scan import GnssFix, ImuSamples
from splitslam.sim.gnss import simulate_gnss
from splitslam.sim.imu import imu_times_ns, simulate_imu, stated_T_lidar_imu
from splitslam.sim.lidar import Sweep, Vlp16, packets
from splitslam.sim.spec import DriveSpec
from splitslam.sim.trajectory import make_trajectory
from splitslam.sim.truth import tum
from splitslam.sim.world import make_world

SCAN_TOPIC, IMU_TOPIC, GNSS_TOPIC = "/velodyne_packets", "/imu/data", "/gps/fix"
_SCAN, _PACKET = "velodyne_msgs/msg/VelodyneScan", "velodyne_msgs/msg/VelodynePacket"
_IMU, _FIX = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
_SCAN_DELAY_NS = 1_000_000  # from the last firing to the recorder
_IMU_DELAY_NS = 200_000
_GNSS_DELAY_NS = 80_000_000

Message = tuple[int, Any]  # arrival time ns, message


@dataclass(frozen=True)
class SimRecording:
    """Where a made drive lies: bag, robot file, truth (TUM): T_world_lidar at each scan's first firing, and densely."""

    bag_path: Path
    robot_path: Path
    truth_path: Path
    imu_truth_path: Path


def simulate(spec: DriveSpec, out_dir: Path, progress: Callable[[int, int], None] | None = None) -> SimRecording:
    """Makes the drive and writes NAME.bag, .yaml, .tum and .imu_truth.tum into `out_dir` (made if missing).

    progress(done, total) is called after each scan. The same spec gives the same bytes. Raises InputError for an
    unknown kind of world.
    """
    world = make_world(spec.world)
    trajectory = make_trajectory(spec.path, world.place, spec.duration_s)
    lidar = Vlp16(spec, world, trajectory)
    out_dir.mkdir(parents=True, exist_ok=True)
    out = SimRecording(*(out_dir / f"{spec.name}.{kind}" for kind in ("bag", "yaml", "tum", "imu_truth.tum")))
    scans_ns: list[int] = []

    def watched() -> Iterator[Sweep]:
        for done, sweep in enumerate(lidar.sweeps(), start=1):
            scans_ns.append(sweep.first_ns)
            yield sweep
            if progress is not None:
                progress(done, lidar.scans)

    part = out.bag_path.with_suffix(".bag.part")
    part.unlink(missing_ok=True)
    _write_bag(part, spec, watched(), simulate_imu(spec, trajectory), simulate_gnss(spec, trajectory))
    part.replace(out.bag_path)
    out.truth_path.write_text(tum(trajectory, spec.start_ns, np.array(scans_ns, np.int64)))
    out.imu_truth_path.write_text(tum(trajectory, spec.start_ns, imu_times_ns(spec)))
    out.robot_path.write_text(robot_file(spec))
    return out


def robot_file(spec: DriveSpec) -> str:
    """The robot file (YAML) of the drive's sensors, as their maker would state them."""
    lidar, imu = spec.lidar, spec.imu
    robot = {
        "robot": {"id": spec.name},
        "lidar": {"model": "vlp16", "topic": SCAN_TOPIC, "stamp": "start", "rings": 16, "columns": 1800}
        | {"rate_hz": lidar.rate_hz, "min_range_m": 0.8, "max_range_m": lidar.max_range_m},
        "imu": {
            "topic": IMU_TOPIC,
            "rate_hz": imu.rate_hz,
            "gyro_noise_radps_rthz": imu.gyro_noise_radps_rthz,
            "accel_noise_mps2_rthz": imu.accel_noise_mps2_rthz,
            "gyro_walk_radps2_rthz": imu.gyro_walk_radps2_rthz,
            "accel_walk_mps3_rthz": imu.accel_walk_mps3_rthz,
        },
        "gnss": None if spec.gnss is None else {"topic": GNSS_TOPIC, "t_lidar_antenna_m": list(spec.gnss.lever_m)},
        "T_lidar_imu": [[round(float(v), 12) for v in row] for row in stated_T_lidar_imu(spec)],
        "gravity_mps2": spec.gravity_mps2,
    }
    return yaml.safe_dump(robot, sort_keys=False, default_flow_style=None, width=120)


def _write_bag(path: Path, spec: DriveSpec, sweeps: Iterable[Sweep], imu: ImuSamples, fixes: list[GnssFix]) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("time stamp\nuint8[1206] data\n", _PACKET))
    store.register(get_types_from_msg("std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n", _SCAN))
    make = _Messages(store.types)
    streams: list[tuple[str, str, Iterator[Message]]] = [
        (SCAN_TOPIC, _SCAN, make.scans(spec, sweeps)),
        (IMU_TOPIC, _IMU, make.imu(imu)),
        *([(GNSS_TOPIC, _FIX, make.fixes(fixes))] if fixes else []),
    ]
    with Writer(path) as bag:
        connections = {topic: bag.add_connection(topic, kind, typestore=store) for topic, kind, _ in streams}
        tagged = [_tagged(*each) for each in streams]
        for at_ns, topic, kind, message in heapq.merge(*tagged, key=lambda item: item[:2]):
            bag.write(connections[topic], at_ns, store.serialize_ros1(message, kind))


def _tagged(topic: str, kind: str, messages: Iterator[Message]) -> Iterator[tuple[int, str, str, Any]]:
    for arrival_ns, message in messages:
        yield arrival_ns, topic, kind, message


class _Messages:
    """Sensor data as ROS 1 messages, each stream in order of arrival."""

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
            yield arrival_ns, self._types[_SCAN](header=header, packets=sent)

    def imu(self, samples: ImuSamples) -> Iterator[Message]:
        vector, quaternion = (self._types[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Quaternion"))
        nowhere = quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
        unknown, no_orientation = np.zeros(9), np.array([-1.0] + [0.0] * 8)  # -1: no such estimate (sensor_msgs/Imu)
        rows = zip(samples.stamps_ns.tolist(), samples.gyro_radps.tolist(), samples.accel_mps2.tolist(), strict=True)
        for n, (stamp_ns, gyro, accel) in enumerate(rows):
            message = self._types[_IMU](
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
            message = self._types[_FIX](
                header=self._header(n, fix.stamp_ns, "gps"),
                status=self._types["sensor_msgs/msg/NavSatStatus"](status=fix.status, service=1),
                latitude=fix.latitude_deg,
                longitude=fix.longitude_deg,
                altitude=fix.altitude_m,
                position_covariance=fix.covariance_enu_m2.ravel(),
                position_covariance_type=2,
            )
            yield fix.stamp_ns + _GNSS_DELAY_NS, message

    def _header(self, seq: int, stamp_ns: int, frame: str) -> Any:
        return self._types["std_msgs/msg/Header"](seq=seq, stamp=self._time(stamp_ns), frame_id=frame)

    def _time(self, stamp_ns: int) -> Any:
        return self._types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
