"""Rigid transforms as (4, 4) float64 matrices: p_a = T_a_b @ p_b.

Tangent vectors are (6,) float64, rotation first (rx ry rz tx ty tz, rad and m), perturbation on the
right: T * exp(xi). This is GTSAM's Pose3 convention, so covariances pass through unchanged.
Formulas: Sola et al., "A micro Lie theory for state estimation in robotics", 2018, sections IV and V.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_SMALL_RAD = 1e-7


def hat(w: Array) -> Array:
    """(3,) -> (3, 3) cross-product matrix."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def so3_exp(w: Array) -> Array:
    """Rotation vector (3,), rad -> rotation matrix (3, 3)."""
    theta = float(np.linalg.norm(w))
    K = hat(w)
    if theta < _SMALL_RAD:
        return np.eye(3) + K + 0.5 * K @ K
    return np.eye(3) + np.sin(theta) / theta * K + (1.0 - np.cos(theta)) / theta**2 * K @ K


def so3_log(R: Array) -> Array:
    """Rotation matrix (3, 3) -> rotation vector (3,), rad, norm in [0, pi]."""
    q = quat_from_matrix(R)
    v, w = q[:3], q[3]
    n = float(np.linalg.norm(v))
    if n < _SMALL_RAD:
        return 2.0 * v / w
    return v * (2.0 * np.arctan2(n, w) / n)


def _left_jacobian(w: Array) -> Array:
    theta = float(np.linalg.norm(w))
    K = hat(w)
    if theta < 1e-5:
        return np.eye(3) + 0.5 * K + K @ K / 6.0
    return np.eye(3) + (1.0 - np.cos(theta)) / theta**2 * K + (theta - np.sin(theta)) / theta**3 * K @ K


def exp(xi: Array) -> Array:
    """Tangent (6,) -> transform (4, 4)."""
    return compose(so3_exp(xi[:3]), _left_jacobian(xi[:3]) @ xi[3:])


def log(T: Array) -> Array:
    """Transform (4, 4) -> tangent (6,)."""
    w = so3_log(T[:3, :3])
    return np.concatenate([w, np.linalg.solve(_left_jacobian(w), T[:3, 3])], dtype=np.float64)


def compose(R: Array, t: Array) -> Array:
    """Rotation (3, 3) and translation (3,), m -> (4, 4)."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inv(T: Array) -> Array:
    """Inverse of a rigid transform."""
    Rt = T[:3, :3].T
    return compose(Rt, -Rt @ T[:3, 3])


def adjoint(T: Array) -> Array:
    """(6, 6) with exp(Ad_T xi) = T exp(xi) T^-1."""
    R = T[:3, :3]
    A = np.zeros((6, 6))
    A[:3, :3] = A[3:, 3:] = R
    A[3:, :3] = hat(T[:3, 3]) @ R
    return A


def angle(T: Array) -> float:
    """Rotation angle of T, rad (also takes a (3, 3) rotation)."""
    (a, b, c), (d, e, f), (g, h, i) = T[:3, :3].tolist()
    return math.atan2(math.hypot(h - f, c - g, d - b), a + e + i - 1.0)


def quat_from_matrix(R: Array) -> Array:
    """Rotation matrix (3, 3) -> unit quaternion (4,) x y z w, w >= 0. Shepperd's method: stable at any angle."""
    candidates = np.array([R[0, 0], R[1, 1], R[2, 2], np.trace(R[:3, :3])])
    i = int(np.argmax(candidates))
    q = np.empty(4)
    if i == 3:
        q[:] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 1.0 + candidates[3]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1.0 + R[i, i] - R[j, j] - R[k, k]
        q[j] = R[j, i] + R[i, j]
        q[k] = R[k, i] + R[i, k]
        q[3] = R[k, j] - R[j, k]
    q /= np.linalg.norm(q)
    return -q if q[3] < 0 else q


def matrix_from_quat(q: Array) -> Array:
    """Quaternion (4,) x y z w, any norm > 0 -> rotation matrix (3, 3)."""
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def from_quat(t: Array, q: Array) -> Array:
    """Translation (3,), m and quaternion (4,) x y z w -> (4, 4)."""
    return compose(matrix_from_quat(q), t)


def interpolate(T_a: Array, T_b: Array, ratio: float) -> Array:
    """Between two poses: rotation by slerp, translation linear; ratio outside [0, 1] extrapolates."""
    w = so3_log(T_a[:3, :3].T @ T_b[:3, :3])
    return compose(T_a[:3, :3] @ so3_exp(ratio * w), (1 - ratio) * T_a[:3, 3] + ratio * T_b[:3, 3])


def orthonormalised(T: Array) -> Array:
    """The nearest rigid transform: long products drift off SO(3)."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    return compose(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt, T[:3, 3])


def level_rotation(up_lidar: Array) -> Array:
    """R_map_lidar (3, 3) with zero yaw whose z axis is `up_lidar` (3,): gravity alignment at start."""
    up = up_lidar / np.linalg.norm(up_lidar)
    forward = np.array([1.0, 0.0, 0.0]) - up[0] * up
    if np.linalg.norm(forward) < 1e-3:  # the sensor looks straight up or down: heading is then arbitrary
        forward = np.array([0.0, 1.0, 0.0]) - up[1] * up
    forward /= np.linalg.norm(forward)
    return np.stack([forward, np.cross(up, forward), up], dtype=np.float64)
