"""Everything that can be said about an IMU once the LiDAR's own motion is known; the same offline and live."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitslam.check import inertial, mounting
from splitslam.check.alignment import Alignment, align
from splitslam.check.coarse import CoarseMatch, match
from splitslam.check.findings import Finding, note
from splitslam.check.motion import LidarMotion
from splitslam.check.mounting import Mounting
from splitslam.robot import Robot
from splitslam.scan import ImuSamples

_UPSIDE_DOWN = np.cos(np.radians(120.0))
_EXPLAINED = 0.8
_NEAR_FILE_DEG = 30.0
_WRONG_SIGNS = {
    "all three axes": np.array([-1.0, -1.0, -1.0]),
    "x": np.array([-1.0, 1.0, 1.0]),
    "y": np.array([1.0, -1.0, 1.0]),
    "z": np.array([1.0, 1.0, -1.0]),
}


@dataclass(frozen=True, slots=True, eq=False)
class ImuVerdict:
    """findings: one line each. samples: in rad/s and m/s2, rising in time. gravity_mps2: size of the specific force.

    match, alignment, mounting: None as far as the motion does not tell them. up_lidar: (3,) unit, or None.
    """

    findings: tuple[Finding, ...]
    samples: ImuSamples
    gravity_mps2: float
    match: CoarseMatch | None = None
    alignment: Alignment | None = None
    mounting: Mounting | None = None
    up_lidar: NDArray[np.float64] | None = None


def judge(robot: Robot, motion: LidarMotion | None, samples: ImuSamples, scan_period_s: float) -> ImuVerdict:
    """motion: LiDAR odometry that does not lean on the IMU, or None. samples: rising in time, as they came."""
    assert robot.imu is not None
    topic = robot.imu.topic or "imu"
    matched = None if motion is None else match(motion, samples)
    obstacle = mounting.excited(matched)
    units = inertial.units(samples, matched, obstacle is None, robot.gravity_mps2, topic)
    samples = units.applied(samples)
    found = list(units.findings)
    gravity_mps2 = inertial.gravity_size(samples)
    if motion is None or matched is None or obstacle is not None:
        found += [obstacle] if obstacle is not None and motion is not None else []
        found += _present(inertial.gravity_direction(samples, robot, None))
        return ImuVerdict(tuple(found), samples, gravity_mps2, matched)
    fit, sign = _fit(robot, motion, samples, matched)
    found += sign
    if fit is None or fit.place is None:
        sigma_deg = 180.0 if fit is None else np.degrees(np.sqrt(np.linalg.eigvalsh(fit.alignment.covariance)[1]))
        text = f"not tested: the motion shows the rotation only to +- {min(sigma_deg, 180.0):.1f} deg"
        found.append(note("T_lidar_imu", text, "turns about two axes at least"))
        found += _present(inertial.gravity_direction(samples, robot, None))
        return ImuVerdict(tuple(found), samples, gravity_mps2, matched)
    if not fit.believable:
        text = (
            f"the gyro explains {max(fit.alignment.explained, 0.0):.0%} of the LiDAR's rotation, whatever its mounting"
        )
        found.append(Finding("imu angular_velocity", text, "nearly all of it (right signs, axes and units)"))
    else:
        found += _present(inertial.gravity_direction(samples, robot, fit.place.R_lidar_imu))
        found += mounting.findings(fit.place, scan_period_s)
    return ImuVerdict(tuple(found), samples, gravity_mps2, matched, fit.alignment, fit.place, fit.up_lidar)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    alignment: Alignment
    place: Mounting | None
    up_lidar: NDArray[np.float64]

    @property
    def believable(self) -> bool:
        """The gyro fits; or, where LiDAR odometry slipped, what is left of it agrees with the file, as by no chance."""
        near = self.place is not None and self.place.angle_deg < mounting.ROTATION_LIMIT_DEG
        return near or self.alignment.explained > _EXPLAINED

    @property
    def plain(self) -> bool:
        """Nothing strange about it: the gyro fits, up is up, and the file is not off by nearly a quarter turn."""
        fits = self.believable and self.up_lidar[2] > _UPSIDE_DOWN
        return fits and self.place is not None and self.place.angle_deg < 60.0


def _fit(
    robot: Robot, motion: LidarMotion, samples: ImuSamples, matched: CoarseMatch
) -> tuple[_Fit | None, list[Finding]]:
    """The alignment; where it looks strange, wrong signs are tried, and taken when they leave nothing strange."""
    fit = _aligned(robot, motion, samples, matched)
    if fit is None or fit.plain:
        return fit, []
    for axes, signs in _WRONG_SIGNS.items():
        other = _aligned(robot, motion, replace(samples, gyro_radps=samples.gyro_radps * signs), matched)
        if other is not None and other.plain and _surer(other, fit):
            text = f"{axes} of the gyro turn{'s' if axes in 'xyz' else ''} the wrong way round"
            return other, [Finding("imu angular_velocity", text, "counter-clockwise positive (right hand)")]
    if fit.up_lidar[2] < _UPSIDE_DOWN:  # accelerations then have the wrong sign too: not to be used as they are
        upright = _aligned(robot, motion, replace(samples, accel_mps2=-samples.accel_mps2), matched)
        return (fit if upright is None else upright), []
    return fit, []


def _surer(fit: _Fit, than: _Fit) -> bool:
    """Near the robot file, and no less certain than what it is to replace."""
    place, other = fit.place, than.place
    if place is None or place.angle_deg > _NEAR_FILE_DEG:
        return False
    size, reference = np.trace(fit.alignment.covariance), np.trace(than.alignment.covariance)
    return bool(size < reference) if other is not None else bool(size < 0.25 * reference)


def _aligned(robot: Robot, motion: LidarMotion, samples: ImuSamples, matched: CoarseMatch) -> _Fit | None:
    alignment = align(motion, samples, robot.T_lidar_imu, robot.gravity_mps2, matched)
    if alignment is None:
        return None
    period_s = float(np.median(np.diff(samples.stamps_ns))) * 1e-9
    place = mounting.compare(alignment, matched, robot, period_s)
    return _Fit(alignment, place, mounting.up_lidar(motion, alignment.gravity_odom_mps2))


def _present(finding: Finding | None) -> list[Finding]:
    return [] if finding is None else [finding]
