"""Wheel odometry: forward speed and yaw rate of frame `body`, with scale errors, noise and slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.seeds import stream
from splitslam.sim.spec import DriveSpec, WheelSpec
from splitslam.sim.trajectory import Trajectory

Array = NDArray[np.float64]

_SLIP_EVERY_S, _SLIP_FOR_S, _FIRST_SLIP_S = 10.0, 1.5, 6.0


@dataclass(frozen=True, eq=False)
class WheelSamples:
    """stamps_ns (N,) int64; speed_mps, yaw_rate_radps (N,) in frame `body`; pose (N, 3): x, y, m, and yaw, rad, as the
    wheels add them up."""

    stamps_ns: NDArray[np.int64]
    speed_mps: Array
    yaw_rate_radps: Array
    pose: Array


def T_body_lidar(spec: DriveSpec) -> Array:
    """(4, 4): `body` lies on the ground below the sensor, where there is no sideways speed; its axes are the same."""
    T = np.eye(4)
    T[2, 3] = spec.path.height_m
    return T


def simulate_wheels(spec: DriveSpec, wheels: WheelSpec, trajectory: Trajectory) -> WheelSamples:
    """All samples of the drive."""
    at_ns = np.rint(np.arange(int(spec.duration_s * wheels.rate_hz)) * 1e9 / wheels.rate_hz).astype(np.int64)
    t_s = at_ns.astype(np.float64) * 1e-9
    true_speed, true_rate = true_wheels(spec, trajectory, t_s)
    rng = stream(spec.seed, "wheels")
    scale = 1.0 + wheels.scale_error * rng.normal(0.0, 1.0, 2)
    noise = rng.normal(0.0, 1.0, (2, len(t_s)))
    speed = scale[0] * true_speed * (1.0 + slip(spec, t_s)) + wheels.speed_noise_mps * noise[0]
    yaw_rate = scale[1] * true_rate + wheels.yaw_rate_noise_radps * noise[1]
    return WheelSamples(spec.start_ns + at_ns, speed, yaw_rate, _added_up(speed, yaw_rate, 1.0 / wheels.rate_hz))


def true_wheels(spec: DriveSpec, trajectory: Trajectory, t_s: Array) -> tuple[Array, Array]:
    """Velocity of the origin of `body` along its x axis (N,), m/s, and its turn about its z axis (N,), rad/s."""
    motion = trajectory.motion(t_s)
    body_in_lidar = -T_body_lidar(spec)[:3, 3]  # the axes are the same
    velocity = np.einsum("nji,nj->ni", motion.R_world_lidar, motion.velocity_mps)
    velocity += np.cross(motion.omega_radps, body_in_lidar)
    return velocity[:, 0], motion.omega_radps[:, 2]


def slip(spec: DriveSpec, t_s: Array) -> Array:
    """By which share the wheels turn too fast (spin) or too slowly (drag), in turns; 0 where they grip."""
    strength = spec.perturbations.wheel_slip
    since = t_s - _FIRST_SLIP_S
    spins = np.floor(since / _SLIP_EVERY_S) % 2 == 0
    slips = (since >= 0.0) & (since % _SLIP_EVERY_S < _SLIP_FOR_S)
    return np.where(slips, np.where(spins, strength, -strength), 0.0)


def _added_up(speed: Array, yaw_rate: Array, dt_s: float) -> Array:
    yaw = np.cumsum(yaw_rate) * dt_s
    return np.stack([np.cumsum(speed * np.cos(yaw)) * dt_s, np.cumsum(speed * np.sin(yaw)) * dt_s, yaw], axis=1)
