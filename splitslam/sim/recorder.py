"""Writes a drive as a robot would have recorded it: a ROS 1 bag, its robot file, and the truth beside it."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer

from splitslam.scan import Scan
from splitslam.sim import messages
from splitslam.sim.gnss import simulate_gnss
from splitslam.sim.grid_lidar import Grid, GridLidar
from splitslam.sim.imu import carried_imu, simulate_imu, stated_T_lidar_imu
from splitslam.sim.lidar import Sweep, Vlp16
from splitslam.sim.spec import DriveSpec
from splitslam.sim.trajectory import Trajectory, drive_trajectory
from splitslam.sim.truth import truth
from splitslam.sim.wheels import T_body_lidar, simulate_wheels
from splitslam.sim.world import make_world
from splitslam.tum import write_tum

SCAN_TOPIC, IMU_TOPIC, GNSS_TOPIC, WHEELS_TOPIC = "/velodyne_packets", "/imu/data", "/gps/fix", "/wheel/odom"
CLOUD_TOPIC = "/points_raw"
Stream = tuple[str, str, Iterator[messages.Message]]  # topic, type, arrivals
_DENSE_NS = 10_000_000  # between them a walker's pose is within 0.1 mm of a straight line


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
    trajectory = drive_trajectory(spec, world.place)
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

    _write_bag(out.bag_path, spec, trajectory, lambda make: (SCAN_TOPIC, messages.SCAN, make.scans(spec, watched())))
    write_tum(out.truth_path, truth(trajectory, spec.start_ns, np.array(scans_ns, np.int64)))
    _write_dense_truth(out.imu_truth_path, spec, trajectory)
    out.robot_path.write_text(robot_file(spec))
    return out


def simulate_grid(
    spec: DriveSpec, grid: Grid, out_dir: Path, progress: Callable[[int, int], None] | None = None
) -> tuple[Path, Path]:
    """The drive with another LiDAR: writes NAME.bag, .yaml and .imu_truth.tum, returns the first two; see simulate."""
    world = make_world(spec.world)
    trajectory = drive_trajectory(spec, world.place)
    lidar = GridLidar(grid, spec, world, trajectory)
    out_dir.mkdir(parents=True, exist_ok=True)
    bag_path, robot_path, truth_path = (out_dir / f"{spec.name}.{kind}" for kind in ("bag", "yaml", "imu_truth.tum"))

    def watched() -> Iterator[Scan]:
        for done, sweep in enumerate(lidar.sweeps(), start=1):
            yield sweep
            if progress is not None:
                progress(done, lidar.scans)

    robot_path.write_text(robot_file(spec, grid))
    _write_dense_truth(truth_path, spec, trajectory)
    _write_bag(bag_path, spec, trajectory, lambda make: (CLOUD_TOPIC, messages.CLOUD, make.clouds(watched())))
    return bag_path, robot_path


def _write_dense_truth(path: Path, spec: DriveSpec, trajectory: Trajectory) -> None:
    stamps_ns = np.arange(int(spec.duration_s * 1e9 / _DENSE_NS) + 1) * _DENSE_NS
    write_tum(path, truth(trajectory, spec.start_ns, stamps_ns))


def robot_file(spec: DriveSpec, grid: Grid | None = None) -> str:
    """The robot file (YAML) of the drive's sensors, as their maker would state them. grid: None for the VLP-16."""
    lidar, imu = spec.lidar, carried_imu(spec)
    if grid is None:
        sensor = {"model": "vlp16", "topic": SCAN_TOPIC, "stamp": "start", "rings": 16, "columns": 1800}
    else:
        sensor = {"model": "generic", "topic": CLOUD_TOPIC, "stamp": "start", "rings": grid.rings}
        sensor |= {
            "columns": grid.columns_a_turn,
            "beam_elevations_deg": [round(e, 6) for e in grid.elevations_deg.tolist()],
        }
    robot = {
        "robot": {"id": spec.name},
        "lidar": sensor | {"rate_hz": lidar.rate_hz, "min_range_m": 0.8, "max_range_m": lidar.max_range_m},
        "imu": {
            "topic": IMU_TOPIC,
            "rate_hz": imu.rate_hz,
            "gyro_noise_radps_rthz": imu.gyro_noise_radps_rthz,
            "accel_noise_mps2_rthz": imu.accel_noise_mps2_rthz,
            "gyro_walk_radps2_rthz": imu.gyro_walk_radps2_rthz,
            "accel_walk_mps3_rthz": imu.accel_walk_mps3_rthz,
        },
        "gnss": None if spec.gnss is None else {"topic": GNSS_TOPIC, "t_lidar_antenna_m": list(spec.gnss.lever_m)},
        "T_lidar_imu": _rows(stated_T_lidar_imu(spec)),
        "gravity_mps2": spec.gravity_mps2,
    }
    if spec.wheels is not None:
        robot |= {"wheels": {"topic": WHEELS_TOPIC}, "T_body_lidar": _rows(T_body_lidar(spec))}
    return yaml.safe_dump(robot, sort_keys=False, default_flow_style=None, width=120)


def _rows(T: NDArray[np.float64]) -> list[list[float]]:
    return [[round(float(v), 12) for v in row] for row in T]


def _write_bag(
    path: Path, spec: DriveSpec, trajectory: Trajectory, scans: Callable[[messages.Messages], Stream]
) -> None:
    """Under another name until it is whole."""
    store = messages.typestore()
    make = messages.Messages(store.types)
    streams = [scans(make), (IMU_TOPIC, messages.IMU, make.imu(simulate_imu(spec, trajectory)))]
    if fixes := simulate_gnss(spec, trajectory):
        streams.append((GNSS_TOPIC, messages.FIX, make.fixes(fixes)))
    if spec.wheels is not None:
        turned = simulate_wheels(spec, spec.wheels, trajectory)
        streams.append((WHEELS_TOPIC, messages.ODOMETRY, make.wheels(spec.wheels, turned)))
    part = path.with_suffix(".bag.part")
    part.unlink(missing_ok=True)
    with Writer(part) as bag:
        connections = {topic: bag.add_connection(topic, kind, typestore=store) for topic, kind, _ in streams}
        tagged = [_tagged(*each) for each in streams]
        for at_ns, topic, kind, message in heapq.merge(*tagged, key=lambda item: item[:2]):
            bag.write(connections[topic], at_ns, store.serialize_ros1(message, kind))
    part.replace(path)


def _tagged(topic: str, kind: str, arrivals: Iterator[messages.Message]) -> Iterator[tuple[int, str, str, Any]]:
    for arrival_ns, message in arrivals:
        yield arrival_ns, topic, kind, message
