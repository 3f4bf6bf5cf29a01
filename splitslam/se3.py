"""Rigid transforms as (4, 4) float64 matrices: p_a = T_a_b @ p_b.

Tangent vectors are (6,) float64, rotation first (rx ry rz tx ty tz, rad and m), perturbation on the
right: T * exp(xi). This is GTSAM's Pose3 convention, so covariances pass through unchanged.
Formulas: Sola et al., "A micro Lie theory for state estimation in robotics", 2018, sections IV and V.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_Row = tuple[float, float, float]
_Rows = tuple[_Row, _Row, _Row]
_SMALL_RAD = 1e-7
_LAST_ROW = (0.0, 0.0, 0.0, 1.0)
_EYE = np.eye(3)
_NEARLY_ORTHONORMAL = 1e-8


def hat(w: Array) -> Array:
    """(3,) -> (3, 3) cross-product matrix."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def so3_exp(w: Array) -> Array:
    """Rotation vector (3,), rad -> rotation matrix (3, 3)."""
    x, y, z = w.tolist()
    return np.array(_rotation(x, y, z))


def so3_log(R: Array) -> Array:
    """Rotation matrix (3, 3) -> rotation vector (3,), rad, norm in [0, pi]."""
    return np.array(_vector(R.tolist()))


def exp(xi: Array) -> Array:
    """Tangent (6,) -> transform (4, 4)."""
    x, y, z, *t = xi.tolist()
    square = x * x + y * y + z * z
    theta = math.sqrt(square)
    if theta < 1e-4:
        b, c = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        b, c = 2.0 * (math.sin(0.5 * theta) / theta) ** 2, (theta - math.sin(theta)) / (square * theta)
    # V t = t + b w x t + c w x (w x t)
    once = _cross((x, y, z), t)
    twice = _cross((x, y, z), once)
    return _transform(_rotation(x, y, z), [v + b * p + c * q for v, p, q in zip(t, once, twice, strict=True)])


def log(T: Array) -> Array:
    """Transform (4, 4) -> tangent (6,)."""
    rows = T.tolist()
    w = _vector(rows)
    t = rows[0][3], rows[1][3], rows[2][3]
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    half = 0.5 * math.sqrt(square)
    c = 1.0 / 12.0 + square / 720.0 if half < 1e-3 else (1.0 - half / math.tan(half)) / square
    # V^-1 t = t - w x t / 2 + c w x (w x t)
    once = _cross(w, t)
    twice = _cross(w, once)
    return np.array([*w, *(v - 0.5 * p + c * q for v, p, q in zip(t, once, twice, strict=True))])


def compose(R: Array, t: Array) -> Array:
    """Rotation (3, 3) and translation (3,), m -> (4, 4)."""
    T = np.empty((4, 4))
    T[:3, :3], T[:3, 3], T[3] = R, t, _LAST_ROW
    return T


def inv(T: Array) -> Array:
    """Inverse of a rigid transform."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = T.tolist()
    rows = (a, d, g), (b, e, h), (c, f, i)
    return _transform(rows, [-(r[0] * x + r[1] * y + r[2] * z) for r in rows])


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
    return np.array(_quaternion(R.tolist()))


def matrix_from_quat(q: Array) -> Array:
    """Quaternion (4,) x y z w, any norm > 0 -> rotation matrix (3, 3)."""
    return np.array(_turned(*q.tolist()))


def from_quat(t: Array | Sequence[float], q: Array | Sequence[float]) -> Array:
    """Translation (3,), m and quaternion (4,) x y z w -> (4, 4)."""
    return _transform(_turned(*_floats(q)), _floats(t))


def interpolate(T_a: Array, T_b: Array, ratio: float) -> Array:
    """Between two poses: rotation by slerp, translation linear; ratio outside [0, 1] extrapolates."""
    w = so3_log(T_a[:3, :3].T @ T_b[:3, :3])
    return compose(T_a[:3, :3] @ so3_exp(ratio * w), (1 - ratio) * T_a[:3, 3] + ratio * T_b[:3, 3])


def orthonormalised(T: Array) -> Array:
    """The nearest rigid transform: long products drift off SO(3)."""
    R = T[:3, :3]
    off = R.T @ R - _EYE
    if np.abs(off).max() < _NEARLY_ORTHONORMAL:  # a step of Newton's iteration then takes all of it
        return compose(R - 0.5 * R @ off, T[:3, 3])
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


# Of so few numbers plain floats are five to ten times faster than arrays.


def _rotation(x: float, y: float, z: float) -> _Rows:
    square = x * x + y * y + z * z
    theta = math.sqrt(square)
    if theta < _SMALL_RAD:
        a, b = 1.0, 0.5
    else:
        a, b = math.sin(theta) / theta, 2.0 * (math.sin(0.5 * theta) / theta) ** 2
    xy, xz, yz = b * x * y, b * x * z, b * y * z
    xx, yy, zz = b * x * x, b * y * y, b * z * z
    ax, ay, az = a * x, a * y, a * z
    return (1.0 - yy - zz, xy - az, xz + ay), (xy + az, 1.0 - xx - zz, yz - ax), (xz - ay, yz + ax, 1.0 - xx - yy)


def _floats(values: Array | Sequence[float]) -> Sequence[float]:
    return values.tolist() if isinstance(values, np.ndarray) else values


def _turned(x: float, y: float, z: float, w: float) -> _Rows:
    s = 2.0 / (x * x + y * y + z * z + w * w)
    return (
        (1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)),
        (s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)),
        (s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)),
    )


def _quaternion(R: Sequence[Sequence[float]]) -> tuple[float, float, float, float]:
    (a, b, c), (d, e, f), (g, h, i) = (row[:3] for row in R[:3])
    trace = a + e + i
    if trace >= max(a, e, i):
        q = h - f, c - g, d - b, 1.0 + trace
    elif a >= e and a >= i:
        q = 1.0 + a - e - i, d + b, g + c, h - f
    elif e >= i:
        q = d + b, 1.0 + e - i - a, h + f, c - g
    else:
        q = g + c, h + f, 1.0 + i - a - e, d - b
    norm = math.copysign(math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), q[3])
    return q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm


def _vector(R: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    x, y, z, w = _quaternion(R)
    n = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 / w if n < _SMALL_RAD else 2.0 * math.atan2(n, w) / n
    return scale * x, scale * y, scale * z


def _cross(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _transform(R: _Rows, t: Sequence[float]) -> Array:
    return np.array(((*R[0], t[0]), (*R[1], t[1]), (*R[2], t[2]), _LAST_ROW))
