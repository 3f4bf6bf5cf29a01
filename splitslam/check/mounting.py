"""What an alignment says against the robot file: rotation of T_lidar_imu, time offset, direction of gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.check.alignment import Alignment
from splitslam.check.coarse import SEARCH_S, CoarseMatch
from splitslam.check.findings import Finding, note
from splitslam.check.motion import LidarMotion
from splitslam.robot import Robot

Array = NDArray[np.float64]

ROTATION_LIMIT_DEG = 3.0
DELAY_LIMIT_S = 0.010
_SURE_SIGMAS = 3.0
_KNOWN_DEG = 1.5  # sigma below which an axis counts as known: a disagreement of 3 degrees is then two sigma
_HINTED_DEG = 15.0  # sigma below which at least a wrong quarter turn shows
_MIN_CORRELATION = 0.7
_MIN_EXCITATION_RADPS = 0.01
_NAMES = np.array(["x", "y", "z"])


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """T_lidar_imu's rotation and the time offset as the motion shows them, beside the robot file's.

    angle_deg: how far the file is off, as far as the motion can tell; sigma_deg: of that angle; axis: (3,) what it is
    turned about, frame `lidar`. unknown_axis: (3,) the axis about which the motion says too little, or None, and its
    unknown_sigma_deg. R_lidar_imu: (3, 3) nearest to the file among all that fit. time_offset_s: what
    `imu.time_offset_ns` should be; delay_limit_s: a difference below is no finding.
    """

    angle_deg: float
    sigma_deg: float
    axis: Array
    unknown_axis: Array | None
    unknown_sigma_deg: float
    R_lidar_imu: Array
    time_offset_s: float
    stated_offset_s: float
    time_sigma_s: float
    delay_limit_s: float
    correlation: float


def excited(match: CoarseMatch | None) -> Finding | None:
    """Why rotation and delay cannot be told from this motion, or None when they can."""
    if match is None:
        return note("T_lidar_imu", "not tested: too few scans that the IMU covers")
    if match.excitation_radps < _MIN_EXCITATION_RADPS:
        return note(
            "T_lidar_imu",
            "not tested, nor imu.time_offset_ns: rotation speed varies by only"
            f" {np.degrees(match.excitation_radps):.2f} deg/s; turn the robot about all three axes",
        )
    if match.correlation < _MIN_CORRELATION:
        return Finding(
            "imu",
            f"gyro and LiDAR do not turn alike (correlation {match.correlation:.2f} at the best delay within"
            f" {SEARCH_S:g} s): the delay is longer, or one of the two is not on this robot or cannot be used",
            f"more than {_MIN_CORRELATION:g}",
        )
    return None


def compare(alignment: Alignment, match: CoarseMatch, robot: Robot, imu_period_s: float) -> Mounting | None:
    """The alignment against the robot file; None when more than one axis is unknown."""
    sigmas, axes = np.linalg.eigh(alignment.covariance)
    sigmas_deg = np.degrees(np.sqrt(np.maximum(sigmas, 0.0)))
    X, R_file, unknown = alignment.R_lidar_imu, robot.T_lidar_imu[:3, :3], None
    off_deg = np.degrees(se3.angle(X @ R_file.T))
    if not (sigmas_deg[2] < _HINTED_DEG and off_deg > max(ROTATION_LIMIT_DEG, _SURE_SIGMAS * sigmas_deg[2])):
        # otherwise, well or hardly known, the file is wrong beyond doubt
        if sigmas_deg[1] > _KNOWN_DEG:
            return None
        if sigmas_deg[2] > _KNOWN_DEG:
            unknown = axes[:, 2]
            X = _turned_towards(R_file, X, unknown)
    error = se3.so3_log(X @ R_file.T)
    angle = float(np.linalg.norm(error))
    axis = error / angle if angle > 1e-9 else np.array([0.0, 0.0, 1.0])
    C = alignment.covariance
    if unknown is not None:
        P = np.eye(3) - np.outer(unknown, unknown)
        C = P @ C @ P
    assert robot.imu is not None
    stated_s = robot.imu.time_offset_ns * 1e-9
    return Mounting(
        angle_deg=float(np.degrees(angle)),
        sigma_deg=float(np.degrees(np.sqrt(axis @ C @ axis))),
        axis=axis,
        unknown_axis=unknown,
        unknown_sigma_deg=0.0 if unknown is None else min(float(sigmas_deg[2]), 180.0),
        R_lidar_imu=X,
        time_offset_s=stated_s - alignment.delay_s,
        stated_offset_s=stated_s,
        time_sigma_s=alignment.delay_sigma_s,
        delay_limit_s=max(DELAY_LIMIT_S, imu_period_s),
        correlation=match.correlation,
    )


def findings(mounting: Mounting, scan_period_s: float) -> list[Finding]:
    """One line each for a wrong rotation, a wrong offset, and what stays unknown."""
    return [*_rotation(mounting), *_delay(mounting, scan_period_s)]


def _rotation(m: Mounting) -> list[Finding]:
    out = []
    about = f"[{', '.join(f'{v:z.2f}' for v in m.axis)}]"
    if m.angle_deg > max(ROTATION_LIMIT_DEG, _SURE_SIGMAS * m.sigma_deg):
        known = "" if m.unknown_axis is None else f"; about {_axis_name(m.unknown_axis)} the motion does not tell"
        out.append(
            Finding(
                "T_lidar_imu",
                f"rotation is off by {m.angle_deg:.1f} deg (+- {m.sigma_deg:.1f}) about {about} of the lidar{known}",
                f"about {_matrix(m.R_lidar_imu)}",
            )
        )
    elif m.unknown_axis is not None:
        out.append(
            note(
                "T_lidar_imu",
                f"about {_axis_name(m.unknown_axis)} the motion shows the rotation only to +- {m.unknown_sigma_deg:.1f}"
                " deg (turn about other axes, or speed up and brake); about the others it is tested",
            )
        )
    return out


def _delay(m: Mounting, scan_period_s: float) -> list[Finding]:
    if 2.0 * m.time_sigma_s > m.delay_limit_s:
        return [
            note(
                "imu.time_offset_ns",
                f"not tested: the motion shows it to +- {m.time_sigma_s * 1e3:.0f} ms only; turn the robot faster",
            )
        ]
    off_s = m.time_offset_s - m.stated_offset_s
    if abs(off_s) <= max(m.delay_limit_s, _SURE_SIGMAS * m.time_sigma_s):
        if abs(off_s) <= max(DELAY_LIMIT_S, _SURE_SIGMAS * m.time_sigma_s):
            return []
        within = (
            f"within one sample of this IMU ({m.delay_limit_s * 1e3:.0f} ms), whose stamp may mean its start or end"
        )
        return [note("imu.time_offset_ns", f"the motion says {off_s * 1e3:+z.0f} ms beside the robot file: {within}")]
    hint = ""
    if abs(abs(off_s) - scan_period_s) < 0.25 * scan_period_s:
        hint = "; it is about one scan: is lidar.stamp (start or end) right?"
    return [
        Finding(
            "imu.time_offset_ns",
            f"{round(m.stated_offset_s * 1e9)}, but the motion says {m.time_offset_s * 1e3:z.1f} ms"
            f" (+- {m.time_sigma_s * 1e3:.1f}): off by {off_s * 1e3:+z.1f} ms{hint}",
            f"about {round(m.time_offset_s * 1e4) * 100_000}",
        )
    ]


def up_lidar(motion: LidarMotion, gravity_odom: Array) -> Array:
    """(3,) unit vector against gravity in frame `lidar`, the mean over all poses."""
    up = -np.einsum("nji,j->i", motion.T_odom_lidar[:, :3, :3], gravity_odom)
    return up / np.linalg.norm(up)


def _turned_towards(R_file: Array, X: Array, axis: Array) -> Array:
    """The rotation nearest to the file's among exp(angle * axis) X: swing and twist of the difference."""
    q = se3.quat_from_matrix(X @ R_file.T)
    twist = np.append(axis * (q[:3] @ axis), q[3])
    if np.linalg.norm(twist) < 1e-9:
        return X
    return se3.matrix_from_quat(twist).T @ X


def _axis_name(axis: Array) -> str:
    """`z` for what is nearly the LiDAR's z axis, else its numbers."""
    k = int(np.argmax(np.abs(axis)))
    if abs(axis[k]) > 0.94:  # 20 degrees
        return f"the lidar's {_NAMES[k]} axis"
    return f"axis [{', '.join(f'{v:z.2f}' for v in axis)}] of the lidar"


def _matrix(R: Array) -> str:
    rows = (", ".join(f"{v:z.4f}" for v in row) for row in R)
    return f"[[{'], ['.join(rows)}]]"
