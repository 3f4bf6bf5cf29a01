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
    alignment = align(motion, samples, robot.T_lidar_imu, robot.gravity_mps2, matched)
    if alignment is not None and mounting.up_lidar(motion, alignment.gravity_odom_mps2)[2] < _UPSIDE_DOWN:
        upright = replace(samples, accel_mps2=-samples.accel_mps2)
        alignment = align(motion, upright, robot.T_lidar_imu, robot.gravity_mps2, matched)
    period_s = float(np.median(np.diff(samples.stamps_ns))) * 1e-9
    place = None if alignment is None else mounting.compare(alignment, matched, robot, period_s)
    if alignment is None or place is None:
        found.append(note("T_lidar_imu", "not tested: the motion is too little for more than one axis"))
        found += _present(inertial.gravity_direction(samples, robot, None))
        return ImuVerdict(tuple(found), samples, gravity_mps2, matched, alignment)
    found += _present(inertial.gravity_direction(samples, robot, place.R_lidar_imu))
    found += mounting.findings(place, scan_period_s)
    up = mounting.up_lidar(motion, alignment.gravity_odom_mps2)
    return ImuVerdict(tuple(found), samples, gravity_mps2, matched, alignment, place, up)


def _present(finding: Finding | None) -> list[Finding]:
    return [] if finding is None else [finding]
