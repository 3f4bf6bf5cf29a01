"""Deskew in plain float64: the back end all others are measured against, and the paper's algorithms to the letter."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.features import Knots

Array = NDArray[np.float64]


class ReferenceDeskewer:
    """Slerp and linear translation between knots, for each point, in float64."""

    name = "reference"

    def effective(self, knots: Knots) -> Knots:
        """The motion this back end removes: all of it."""
        return knots

    def deskew(
        self,
        points_lidar: NDArray[np.float32],
        t_offset_ns: NDArray[np.int32],
        knots: Knots,
        out: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """See edge_agent.deskew.Deskewer."""
        out[:] = deskew_float64(points_lidar.astype(np.float64), t_offset_ns, knots)
        return out


def deskew_float64(points_lidar: Array, t_offset_ns: NDArray[np.int32], knots: Knots) -> Array:
    """T_start_lidar(t) @ p in float64: points (N, 3) m -> (N, 3) m."""
    rotations = np.stack([se3.so3_exp(w) for w in knots.rotation])
    steps = np.stack([se3.so3_log(a.T @ b) for a, b in pairwise(rotations)])
    offsets = knots.offsets_ns
    t = np.clip(t_offset_ns, offsets[0], offsets[-1])
    k = np.clip(np.searchsorted(offsets, t, side="right") - 1, 0, len(offsets) - 2)
    ratio = (t - offsets[k]) / (offsets[k + 1] - offsets[k])
    within = np.einsum("nij,nj->ni", _so3_exp_many(ratio[:, None] * steps[k]), points_lidar)
    translation = (1 - ratio)[:, None] * knots.translation_m[k] + ratio[:, None] * knots.translation_m[k + 1]
    return np.einsum("nij,nj->ni", rotations[k], within) + translation


def _so3_exp_many(w: Array) -> Array:
    """Rodrigues' formula for (N, 3) rotation vectors."""
    theta = np.linalg.norm(w, axis=1)[:, None, None]
    K = np.zeros((len(w), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
    K -= K.transpose(0, 2, 1)
    return np.eye(3) + np.sinc(theta / np.pi) * K + 0.5 * np.sinc(theta / (2 * np.pi)) ** 2 * (K @ K)


@dataclass(frozen=True, slots=True, eq=False)
class EulerMotion:
    """The motion of one scan as the paper's Image node has it.

    angles_rad: R_imu, (K, 3) roll, pitch, yaw accumulated from the gyroscope, R = Rz Ry Rx. times_s: T_imu, (K,),
    increasing. o_inc_m: (3,) odometry change from the scan's start to its end. start_s, end_s: of the scan.
    """

    angles_rad: Array
    times_s: Array
    o_inc_m: Array
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Algorithm1Result:
    """The outputs of Algorithm 1, in the order in which the points were accepted."""

    points_deskewed: Array  # (M, 3) m
    ranges_m: Array  # (M,) D, raw
    columns: NDArray[np.int64]  # (M,) N_col
    rings: NDArray[np.int64]  # (M,)


def algorithm_1(points: Array, times_s: Array, rings: NDArray[np.int64], motion: EulerMotion, shape: tuple[int, int]):
    """Paper, Algorithm 1, and LIO-SAM's `projectPointCloud`: project, first point of a cell wins, deskew.

    points: (N, 3) m at their own times; times_s: (N,); shape: rings and columns of the image.
    """
    M_inv = se3.inv(_pose(float(times_s[0]), motion))  # line 1: the LiDAR at the first point
    taken = np.zeros(shape, dtype=bool)
    kept: list[tuple[Array, float, int, int]] = []
    for p, t, row in zip(points, times_s, rings, strict=True):  # lines 4-8
        d = float(np.linalg.norm(p))  # line 9
        column = lio_sam_column(p, shape[1])  # line 11
        if not 0 <= row < shape[0] or taken[row, column]:  # line 12
            continue
        taken[row, column] = True
        kept.append((algorithm_2(p, float(t), motion, M_inv), d, column, int(row)))  # lines 15-17
    return Algorithm1Result(
        points_deskewed=np.array([k[0] for k in kept]).reshape(-1, 3),
        ranges_m=np.array([k[1] for k in kept]),
        columns=np.array([k[2] for k in kept], dtype=np.int64),
        rings=np.array([k[3] for k in kept], dtype=np.int64),
    )


def algorithm_2(p: Array, t_lidar_s: float, motion: EulerMotion, M_inv: Array) -> Array:
    """Paper, Algorithm 2: one point deskewed, (3,) m."""
    A = _pose(t_lidar_s, motion)  # lines 1-8
    B = M_inv @ A  # line 9
    return B[:3, :3] @ p + B[:3, 3]  # line 10


def _pose(t_lidar_s: float, motion: EulerMotion) -> Array:
    return se3.compose(euler_matrix(equation_1(t_lidar_s, motion)), equation_2(t_lidar_s, motion))


def equation_1(t_lidar_s: float, motion: EulerMotion) -> Array:
    """Rotation angles (3,) rad at a point's time, linear between the IMU samples before (b) and after (a) it.

    The paper's text has t_a <= t <= t_b; the names (and LIO-SAM) say t_b <= t <= t_a. After the last sample it holds.
    """
    after = min(int(np.searchsorted(motion.times_s, t_lidar_s, side="right")), len(motion.times_s) - 1)
    if after == 0 or t_lidar_s > motion.times_s[after]:
        return motion.angles_rad[after]
    before = after - 1
    t_b = t_lidar_s - motion.times_s[before]
    t_a = motion.times_s[after] - t_lidar_s
    return (motion.angles_rad[before] * t_a + motion.angles_rad[after] * t_b) / (t_a + t_b)


def equation_2(t_lidar_s: float, motion: EulerMotion) -> Array:
    """Translation (3,) m at a point's time; the paper's ratio lacks `- t_start`, without which it makes no sense."""
    r = (t_lidar_s - motion.start_s) / (motion.end_s - motion.start_s)
    return r * motion.o_inc_m


def euler_matrix(rpy_rad: Array) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll), (3, 3): PCL's getTransformation."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy_rad), np.cos(rpy_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def lio_sam_column(p: Array, columns: int) -> int:
    """LIO-SAM's column of a point: grows counter-clockwise, +x in the middle, halves rounded away from zero."""
    horizon_deg = np.degrees(np.arctan2(p[0], p[1]))
    v = (horizon_deg - 90.0) / (360.0 / columns)
    column = -int(np.copysign(np.floor(abs(v) + 0.5), v)) + columns // 2
    return column % columns
