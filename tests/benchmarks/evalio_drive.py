"""A recording through evalio's own interface: evalio_drive.py BAG ROBOT SCANS OUT.tum

Run where evalio can be imported. What a data set of evalio would give is made of the recording: scans row by row with
empty cells, IMU samples one at a time, the sensors' parameters.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from evalio import types
from evalio.pipelines import get_pipeline, register_pipeline

from edge_agent.sources import open_recording
from splitslam import se3
from splitslam.robot import Robot, load_robot
from splitslam.scan import ImuSamples, Scan
from splitslam.tum import Trajectory, write_tum


def cloud(scan: Scan) -> types.LidarMeasurement:
    """With a cell that saw nothing in each row."""
    columns = (scan.points_lidar.T, scan.intensity, scan.t_offset_ns, scan.ring)
    (x, y, z), intensity, t, ring = (column.tolist() for column in columns)
    points = [
        types.Point(x=x[i], y=y[i], z=z[i], intensity=intensity[i], t=types.Duration.from_nsec(t[i]), row=ring[i])
        for i in np.lexsort((scan.t_offset_ns, scan.ring)).tolist()
    ]
    points += [types.Point(row=row) for row in range(max(ring) + 1)]
    return types.LidarMeasurement(types.Stamp.from_nsec(scan.stamp_ns), points)


def pipeline(robot: Robot):
    """As evalio's own `Experiment.setup` does it."""
    assert register_pipeline(module="splitslam.evalio") == 1
    made = get_pipeline("splitslam")()
    assert made.set_params({**made.default_params(), "soup": 1}) == {"soup": 1}
    lidar, imu = robot.lidar, robot.imu
    assert imu is not None
    made.set_imu_params(
        types.ImuParams(
            gyro=imu.gyro_noise_radps_rthz,
            accel=imu.accel_noise_mps2_rthz,
            gyro_bias=imu.gyro_walk_radps2_rthz,
            accel_bias=imu.accel_walk_mps3_rthz,
            gravity=np.array([0.0, 0.0, -robot.gravity_mps2]),
            rate=imu.rate_hz,
        )
    )
    shape = {"num_rows": lidar.rings, "num_columns": lidar.columns, "rate": lidar.rate_hz}
    made.set_lidar_params(types.LidarParams(**shape, min_range=lidar.min_range_m, max_range=lidar.max_range_m))
    made.set_imu_T_lidar(types.SE3.from_mat(se3.inv(robot.T_lidar_imu)))
    made.initialize()
    return made


def main() -> None:
    bag, robot_file, scans, out = sys.argv[1:]
    robot = load_robot(Path(robot_file))
    system = pipeline(robot)
    system.add_lidar(types.LidarMeasurement(types.Stamp.from_nsec(0)))
    assert system.left_out == {"empty": 1}
    stamps_ns, poses = [], []
    with open_recording(Path(bag), robot, max_scans=int(scans)) as recording:
        for _, event in recording.events():
            if isinstance(event, ImuSamples):
                for stamp_ns, gyro, accel in zip(event.stamps_ns, event.gyro_radps, event.accel_mps2, strict=True):
                    system.add_imu(types.ImuMeasurement(types.Stamp.from_nsec(int(stamp_ns)), gyro, accel))
            elif isinstance(event, Scan):
                system.add_lidar(cloud(event))
            for stamp, pose in system.saved_estimates():
                stamps_ns.append(stamp.to_nsec())
                poses.append(pose.to_mat() @ se3.inv(robot.T_lidar_imu))
    assert system.map()["keyframes"]
    T = np.array(poses)
    quats = np.array([se3.quat_from_matrix(pose[:3, :3]) for pose in T])
    write_tum(Path(out), Trajectory(np.array(stamps_ns), T[:, :3, 3].copy(), quats))


if __name__ == "__main__":
    main()
