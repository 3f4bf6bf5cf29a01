"""An IMU's units and the sign of gravity."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitslam.check.coarse import CoarseMatch
from splitslam.check.findings import Finding
from splitslam.robot import Robot
from splitslam.scan import ImuSamples

Array = NDArray[np.float64]

_G_MPS2 = 9.80665
_ACCEL_UNITS = {"g": _G_MPS2, "mg": _G_MPS2 * 1e-3, "cm/s^2": 1e-2}
_NEAR = 0.25  # relative: vehicles shake and biases are what they are
_FASTEST_RADPS = 70.0  # 4,000 deg/s: beyond what an IMU on a robot can measure
_DEG = float(np.radians(1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Units:
    """Factors that bring a stream to rad/s and m/s2, and what there is to say about it."""

    gyro_factor: float
    accel_factor: float
    findings: tuple[Finding, ...]

    def applied(self, samples: ImuSamples) -> ImuSamples:
        """The samples as they should have been."""
        if self.gyro_factor == 1.0 and self.accel_factor == 1.0:
            return samples
        return replace(
            samples,
            gyro_radps=samples.gyro_radps * self.gyro_factor,
            accel_mps2=samples.accel_mps2 * self.accel_factor,
        )


def units(samples: ImuSamples, match: CoarseMatch | None, turns: bool, gravity_mps2: float, topic: str) -> Units:
    """Looks at magnitudes. match: the gyro against the LiDAR, `turns`: and there was enough to compare."""
    gyro, gyro_finding = _gyro(samples, match if turns else None, topic)
    accel, accel_finding = _accel(samples, gravity_mps2, topic)
    return Units(gyro, accel, tuple(f for f in (gyro_finding, accel_finding) if f is not None))


def _gyro(samples: ImuSamples, match: CoarseMatch | None, topic: str) -> tuple[float, Finding | None]:
    where, fastest = f"{topic} angular_velocity", float(np.linalg.norm(samples.gyro_radps, axis=1).max())
    if match is not None and abs(match.scale / _DEG - 1.0) < _NEAR:
        return _DEG, Finding(where, f"is in deg/s: {1 / match.scale:.1f} times what the LiDAR turns", "rad/s")
    if match is not None and match.correlation > 0.9 and abs(match.scale - 1.0) > 0.1:
        return 1.0, Finding(where, f"is {1 / match.scale:.2f} times what the LiDAR turns", "rad/s, 1.00 times")
    if match is None and fastest > _FASTEST_RADPS:
        return _DEG, Finding(where, f"reaches {fastest:.0f}: that looks like deg/s", "rad/s")
    return 1.0, None


def _accel(samples: ImuSamples, gravity_mps2: float, topic: str) -> tuple[float, Finding | None]:
    where, size = f"{topic} linear_acceleration", gravity_size(samples)
    for unit, factor in _ACCEL_UNITS.items():
        if abs(size * factor / gravity_mps2 - 1.0) < _NEAR:
            return factor, Finding(where, f"is in {unit}: its size is {size:.2f}", f"m/s^2, about {gravity_mps2:.2f}")
    if size < 0.3 * gravity_mps2:
        return 1.0, Finding(
            where, f"holds no gravity: its size is {size:.2f} m/s^2", f"about {gravity_mps2:.2f} at rest"
        )
    if abs(size / gravity_mps2 - 1.0) > 0.1:
        return 1.0, Finding(where, f"its size is {size:.2f} m/s^2", f"about {gravity_mps2:.2f} at rest")
    return 1.0, None


def gravity_size(samples: ImuSamples) -> float:
    """Typical size of the specific force: that of its mean over a second, which shaking does not raise."""
    t = (samples.stamps_ns - samples.stamps_ns[0]) // 1_000_000_000
    starts = np.flatnonzero(np.diff(t, prepend=-1))
    means = np.add.reduceat(samples.accel_mps2, starts, axis=0) / np.diff(np.append(starts, len(t)))[:, None]
    return float(np.median(np.linalg.norm(means, axis=1)))


def gravity_direction(samples: ImuSamples, robot: Robot, R_lidar_imu: Array | None) -> Finding | None:
    """Is up where the LiDAR's z axis is? R_lidar_imu (3, 3): as the motion shows it, None when that is not known."""
    R = robot.T_lidar_imu[:3, :3] if R_lidar_imu is None else R_lidar_imu
    force = R @ np.median(samples.accel_mps2, axis=0)
    up = force / max(float(np.linalg.norm(force)), 1e-9)
    tilt_deg = float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0))))
    if tilt_deg < 60.0:
        return None
    found = f"up is {tilt_deg:.0f} deg away from the lidar's z axis"
    if tilt_deg > 120.0 and R_lidar_imu is not None:
        return Finding("imu linear_acceleration", f"{found}: its sign is wrong", "+g upwards at rest (specific force)")
    if tilt_deg > 120.0:
        expected = "+g upwards at rest: either the accelerometer's sign or T_lidar_imu is wrong"
        return Finding("T_lidar_imu", found, expected)
    if R_lidar_imu is None:
        return Finding("T_lidar_imu", found, "z up, within 60 deg (frame lidar: x forward, y left, z up)")
    return None
