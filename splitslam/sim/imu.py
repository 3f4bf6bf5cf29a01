"""An IMU carried along: angular velocity and specific force at its own place, in its own frame, with its faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from splitslam.scan import ImuSamples
from splitslam.sim.seeds import stream
from splitslam.sim.spec import DriveSpec, ImuSpec
from splitslam.sim.trajectory import Trajectory

Array = NDArray[np.float64]

_TAIL_S = 0.02


def carried_imu(spec: DriveSpec) -> ImuSpec:
    """The IMU as it is mounted and clocked in this drive; the robot file says so too."""
    faults, imu = spec.perturbations, spec.imu
    if faults.imu_random_mounting:
        turn = Rotation.from_quat(stream(spec.seed, "mounting").normal(size=4))  # uniform over all orientations
        roll, pitch, yaw = turn.as_euler("xyz", degrees=True).tolist()
        imu = replace(imu, mounting_rpy_deg=(roll, pitch, yaw))
    return replace(imu, rate_hz=faults.imu_rate_hz) if faults.imu_rate_hz > 0.0 else imu


def T_lidar_imu(spec: ImuSpec) -> Array:
    """The true mounting, (4, 4)."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", spec.mounting_rpy_deg, degrees=True).as_matrix()
    T[:3, 3] = spec.lever_m
    return T


def stated_T_lidar_imu(spec: DriveSpec) -> Array:
    """What the robot file says: the true mounting, turned about a random axis by `extrinsic_error_deg`."""
    T = T_lidar_imu(carried_imu(spec))
    axis = stream(spec.seed, "extrinsic").normal(size=3)
    error = np.radians(spec.perturbations.extrinsic_error_deg) * axis / np.linalg.norm(axis)
    T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(error).as_matrix()
    return T


def imu_times_ns(spec: DriveSpec) -> NDArray[np.int64]:
    """When samples are taken, (N,) since the drive's start: all of the drive and a few that cover the last scan."""
    rate_hz = carried_imu(spec).rate_hz
    count = int((spec.duration_s + _TAIL_S) * rate_hz) + 1
    return np.rint(np.arange(count) * 1e9 / rate_hz).astype(np.int64)


def simulate_imu(spec: DriveSpec, trajectory: Trajectory) -> ImuSamples:
    """All samples of the drive, as the IMU measures and stamps them."""
    t_s = imu_times_ns(spec).astype(np.float64) * 1e-9
    gyro, accel = true_imu(spec, trajectory, t_s)
    faults, imu = spec.perturbations, carried_imu(spec)
    speed = np.linalg.norm(trajectory.motion(t_s).velocity_mps, axis=1)
    shake = faults.imu_vibration_mps2 * np.clip(speed / 0.5, 0.0, 1.0)[:, None]
    phase = stream(spec.seed, "vibration").uniform(0.0, 2 * np.pi, (2, 3))
    accel = accel + shake * np.sin(2 * np.pi * 37.0 * t_s[:, None] + phase[0])
    gyro = gyro + 0.1 * shake * np.sin(2 * np.pi * 37.0 * t_s[:, None] + phase[1])
    gyro = _measured(spec, "gyro", gyro, imu.gyro_noise_radps_rthz, imu.gyro_walk_radps2_rthz, imu.gyro_bias_radps)
    accel = _measured(spec, "accel", accel, imu.accel_noise_mps2_rthz, imu.accel_walk_mps3_rthz, imu.accel_bias_mps2)
    there = (t_s < faults.imu_dropout_at_s) | (t_s >= faults.imu_dropout_at_s + faults.imu_dropout_s)
    return ImuSamples(_stamps(spec, t_s)[there], gyro[there], accel[there])


def true_imu(spec: DriveSpec, trajectory: Trajectory, t_s: Array) -> tuple[Array, Array]:
    """Angular velocity (N, 3), rad/s, and specific force (N, 3), m/s2, in the imu frame at times (N,), s."""
    T = T_lidar_imu(carried_imu(spec))
    R_lidar_imu, lever = T[:3, :3], T[:3, 3]
    m = trajectory.motion(t_s)
    swing = np.cross(m.alpha_radps2, lever) + np.cross(m.omega_radps, np.cross(m.omega_radps, lever))
    against_gravity = m.acceleration_mps2 + np.array([0.0, 0.0, spec.gravity_mps2])
    force_lidar = np.einsum("nji,nj->ni", m.R_world_lidar, against_gravity) + swing
    return m.omega_radps @ R_lidar_imu, force_lidar @ R_lidar_imu


def _measured(spec: DriveSpec, name: str, true: Array, white: float, walk: float, turn_on: float) -> Array:
    rng = stream(spec.seed, name)
    rate, faults = carried_imu(spec).rate_hz, spec.perturbations
    matrix = np.eye(3) + np.diag(rng.normal(0.0, 1.0, 3) * faults.imu_scale)
    matrix += np.radians(faults.imu_misalignment_deg) * rng.normal(0.0, 1.0, (3, 3)) * (1.0 - np.eye(3))
    bias = turn_on * rng.normal(0.0, 1.0, 3) + walk / np.sqrt(rate) * np.cumsum(
        rng.normal(0.0, 1.0, true.shape), axis=0
    )
    return true @ matrix.T + bias + white * np.sqrt(rate) * rng.normal(0.0, 1.0, true.shape)


def _stamps(spec: DriveSpec, t_s: Array) -> NDArray[np.int64]:
    faults = spec.perturbations
    late = np.abs(stream(spec.seed, "imu jitter").normal(0.0, faults.imu_time_jitter_s, len(t_s)))
    told = np.rint((t_s + faults.imu_time_offset_s + late) * 1e9).astype(np.int64)
    # A driver stamps one message after the other, at least a microsecond apart.
    floor = np.arange(len(told)) * 1_000
    return spec.start_ns + np.maximum.accumulate(told - floor) + floor
