"""The true motion: one quintic spline over (x, y, z, yaw, pitch, roll), so that every derivative is exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from splitslam.sim.place import Place
from splitslam.sim.spec import DriveSpec, PathSpec, SpeedChange

Array = NDArray[np.float64]

_KNOT_S = 0.02
MARGIN_S = 1.0  # the spline goes on beyond both ends: no end effects inside the drive


@dataclass(frozen=True, eq=False)
class Motion:
    """At N times. R_world_lidar (N, 3, 3); position_m, velocity_mps, acceleration_mps2 (N, 3) in the world frame;
    omega_radps, alpha_radps2 (N, 3): angular velocity and acceleration in the lidar frame."""

    R_world_lidar: Array
    position_m: Array
    velocity_mps: Array
    acceleration_mps2: Array
    omega_radps: Array
    alpha_radps2: Array


class Trajectory:
    """T_world_lidar as a function of the time since the drive's start, s.

    Pieces follow each other at `breaks_s`: there the sensor is at once elsewhere.
    """

    def __init__(self, splines: Sequence[BSpline], breaks_s: Sequence[float] = ()) -> None:
        self._derivatives = [[spline.derivative(n) if n else spline for spline in splines] for n in range(3)]
        self._breaks_s = np.array(breaks_s, float)

    def poses(self, t_s: Array) -> tuple[Array, Array]:
        """(N,) -> R_world_lidar (N, 3, 3), position (N, 3), m."""
        state = self._at(t_s, 0)
        return _rotation(*state[:, 3:].T), state[:, :3]

    def _at(self, t_s: Array, derivative: int) -> Array:
        """(N,) -> (N, 6): the derivative of x, y, z, yaw, pitch, roll."""
        splines = self._derivatives[derivative]
        piece = np.searchsorted(self._breaks_s, t_s, side="right")
        out = np.empty((len(t_s), 6))
        for k in np.unique(piece).tolist():
            out[piece == k] = splines[k](t_s[piece == k])
        return out

    def T_world_lidar(self, t_s: float) -> Array:
        """One pose, (4, 4)."""
        R, p = self.poses(np.array([t_s]))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R[0], p[0]
        return T

    def motion(self, t_s: Array) -> Motion:
        """(N,) -> pose and its exact derivatives."""
        x, v, a = (self._at(t_s, derivative) for derivative in range(3))
        _, pitch, roll = x[:, 3:].T
        dyaw, dpitch, droll = v[:, 3:].T
        ddyaw, ddpitch, ddroll = a[:, 3:].T
        sp, cp, sr, cr = np.sin(pitch), np.cos(pitch), np.sin(roll), np.cos(roll)
        # Body rates of R = Rz(yaw) Ry(pitch) Rx(roll), and their time derivative.
        omega = np.stack([droll - dyaw * sp, dpitch * cr + dyaw * cp * sr, -dpitch * sr + dyaw * cp * cr], axis=1)
        alpha = np.stack(
            [
                ddroll - ddyaw * sp - dyaw * dpitch * cp,
                ddpitch * cr - dpitch * droll * sr + ddyaw * cp * sr - dyaw * dpitch * sp * sr + dyaw * droll * cp * cr,
                -ddpitch * sr
                - dpitch * droll * cr
                + ddyaw * cp * cr
                - dyaw * dpitch * sp * cr
                - dyaw * droll * cp * sr,
            ],
            axis=1,
        )
        return Motion(_rotation(*x[:, 3:].T), x[:, :3], v[:, :3], a[:, :3], omega, alpha)


def kidnaps_s(spec: DriveSpec) -> tuple[float, ...]:
    """When the sensor is put elsewhere."""
    faults = spec.perturbations
    return tuple(t for t in faults.kidnap_at_s if faults.kidnap_m > 0.0 and t < spec.duration_s)


def drive_trajectory(spec: DriveSpec, place: Place) -> Trajectory:
    """The way of the drive, kidnappings included: each puts the sensor back along its way."""
    breaks_s = kidnaps_s(spec)
    back_m = np.arange(len(breaks_s) + 1) * spec.perturbations.kidnap_m
    return Trajectory([_spline(spec.path, place, spec.duration_s, float(m)) for m in back_m], breaks_s)


def make_trajectory(path: PathSpec, place: Place, duration_s: float) -> Trajectory:
    """The way of `path` over the ground of `place`; good from 1 s before the start to 1 s after `duration_s`."""
    return Trajectory([_spline(path, place, duration_s, 0.0)])


def _spline(path: PathSpec, place: Place, duration_s: float, back_m: float) -> BSpline:
    """x, y, z, yaw, pitch, roll over time, `back_m` behind."""
    t = np.arange(-MARGIN_S, duration_s + MARGIN_S + _KNOT_S, _KNOT_S)
    way, length_m = _arc_length_curve(path)
    distance, speed, thrust = _progress(path, t)
    distance = distance - back_m
    going = np.minimum(speed / path.speed_mps, 1.0)
    if not path.closed and distance[-1] > length_m:
        raise ValueError(f"the drive covers {distance[-1]:.1f} m, but its open path has only {length_m:.1f} m")
    xy, tangent = way(distance)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    side = np.stack([-np.sin(heading), np.cos(heading)], axis=1)

    step = 2 * np.pi * 1.8 * t  # two steps are one stride
    sway = path.gait * going
    xy = xy + (0.012 * sway * np.sin(step / 2))[:, None] * side
    z = place.ground_m(xy[:, 0], xy[:, 1]) + path.height_m + _climbed(path, t) + 0.018 * sway * np.cos(step)
    yaw = heading + _head_turns(path, t) + np.radians(1.2) * sway * np.sin(step / 2 + 0.7)
    slope_m = 0.5
    ahead, left = xy + slope_m * tangent, xy + slope_m * side
    ground = place.ground_m(xy[:, 0], xy[:, 1])
    pitch = -path.leans * np.arctan((place.ground_m(ahead[:, 0], ahead[:, 1]) - ground) / slope_m)
    roll = path.leans * np.arctan((place.ground_m(left[:, 0], left[:, 1]) - ground) / slope_m)
    pitch = pitch - np.radians(path.dive_deg_per_mps2) * thrust
    pitch = pitch + np.radians(0.8) * sway * np.sin(step + 0.4)
    roll = roll + np.radians(1.0) * sway * np.sin(step / 2 + 1.9)
    return make_interp_spline(t, np.column_stack([xy, z, yaw, pitch, roll]), k=5)


def _progress(path: PathSpec, t: Array) -> tuple[Array, Array, Array]:
    """Distance gone (m), speed (m/s) and acceleration along the way (m/s2)."""
    if path.accel_s == 0.0:
        changes, at_first = path.speed_changes, path.speed_mps
    else:
        changes, at_first = (SpeedChange(path.stand_s, path.speed_mps, path.accel_s), *path.speed_changes), 0.0
    distance, speed, thrust = at_first * (t - t[0]), np.full_like(t, at_first), np.zeros_like(t)
    before = at_first
    for change in changes:
        by = change.to_mps - before
        u = np.clip((t - change.at_s) / change.over_s, 0.0, 1.0)
        speed += by * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
        thrust += by / change.over_s * 30.0 * (u * (1.0 - u)) ** 2
        ramp = change.over_s * u**4 * (2.5 - 3.0 * u + u * u)
        distance += by * (ramp + np.maximum(t - change.at_s - change.over_s, 0.0))
        before = change.to_mps
    return distance, speed, thrust


def _head_turns(path: PathSpec, t: Array) -> Array:
    yaw = np.zeros_like(t)
    for turn in path.head_turns:
        u = np.clip((t - turn.at_s) / turn.over_s, 0.0, 1.0)
        yaw += np.radians(turn.yaw_deg) * 64.0 * (u * (1.0 - u)) ** 3
    return yaw


def _climbed(path: PathSpec, t: Array) -> Array:
    """How far what flies has risen, m."""
    z = np.zeros_like(t)
    for climb in path.climbs:
        u = np.clip((t - climb.at_s) / climb.over_s, 0.0, 1.0)
        z += climb.by_m * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    return z


def _arc_length_curve(path: PathSpec):
    """A smooth curve through the waypoints as a function of its length, and that length."""
    points = np.array(path.waypoints_m, float)
    if path.closed:
        points = np.concatenate([points, points[:1]])
    chord = np.concatenate([[0.0], np.cumsum(np.sqrt(np.linalg.norm(np.diff(points, axis=0), axis=1)))])
    curve = make_interp_spline(chord, points, k=5 if path.closed else min(5, len(points) - 1),
                               bc_type="periodic" if path.closed else None)  # fmt: skip
    rate = curve.derivative()
    u = np.linspace(0.0, chord[-1], 20_001)
    speed = np.linalg.norm(rate(u), axis=1)
    length = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(u))])
    inverse = make_interp_spline(length, u, k=3)

    def way(distance_m: Array) -> tuple[Array, Array]:
        if path.closed:
            laps = np.floor(distance_m / length[-1])
            at = inverse(distance_m - laps * length[-1])
        else:
            at = inverse(distance_m)
        tangent = rate(at)
        return curve(at), tangent / np.linalg.norm(tangent, axis=1)[:, None]

    return way, float(length[-1])


def _rotation(yaw: Array, pitch: Array, roll: Array) -> Array:
    cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    R = np.empty((len(yaw), 3, 3))
    R[:, 0, 0], R[:, 0, 1], R[:, 0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    R[:, 1, 0], R[:, 1, 1], R[:, 1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    R[:, 2, 0], R[:, 2, 1], R[:, 2, 2] = -sp, cp * sr, cp * cr
    return R
