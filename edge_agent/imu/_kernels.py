"""IMU kernels: strap-down integration and the emission of continuous poses.

State row layout (M, 15): R_odom_imu row-major (9), position (3), velocity (3).
Integration by the trapezoidal rule on SO(3), Forster et al., "On-Manifold Preintegration", 2017, equations 29-31,
with the mean of neighbouring samples, so that a 10 Hz IMU is as usable as a 500 Hz one.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

FASTMATH = {"contract", "arcp", "nsz"}


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def rotation(wx, wy, wz, out):
    """out (3, 3) = exp of the rotation vector."""
    theta2 = wx * wx + wy * wy + wz * wz
    if theta2 < 1e-14:
        a, b = 1.0, 0.5
    else:
        theta = math.sqrt(theta2)
        a, b = math.sin(theta) / theta, (1.0 - math.cos(theta)) / theta2
    out[0, 0] = 1.0 - b * (wy * wy + wz * wz)
    out[0, 1] = b * wx * wy - a * wz
    out[0, 2] = b * wx * wz + a * wy
    out[1, 0] = b * wx * wy + a * wz
    out[1, 1] = 1.0 - b * (wx * wx + wz * wz)
    out[1, 2] = b * wy * wz - a * wx
    out[2, 0] = b * wx * wz - a * wy
    out[2, 1] = b * wy * wz + a * wx
    out[2, 2] = 1.0 - b * (wx * wx + wy * wy)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def integrate(stamps_ns, gyro, accel, bias, gravity_mps2, states):
    """Fills states (M, 15) from row 0 on: gyro, accel (M, 3) in `imu`, bias (6,) gyro first, gravity along -z."""
    D = np.empty((3, 3))
    for k in range(1, len(stamps_ns)):
        dt = (stamps_ns[k] - stamps_ns[k - 1]) * 1e-9
        wx = 0.5 * (gyro[k, 0] + gyro[k - 1, 0]) - bias[0]
        wy = 0.5 * (gyro[k, 1] + gyro[k - 1, 1]) - bias[1]
        wz = 0.5 * (gyro[k, 2] + gyro[k - 1, 2]) - bias[2]
        s, o = states[k - 1], states[k]
        rotation(wx * dt, wy * dt, wz * dt, D)
        for r in range(3):
            for c in range(3):
                o[3 * r + c] = s[3 * r] * D[0, c] + s[3 * r + 1] * D[1, c] + s[3 * r + 2] * D[2, c]
        for r in range(3):
            a = 0.0
            for c in range(3):
                before = s[3 * r + c] * (accel[k - 1, c] - bias[3 + c])
                after = o[3 * r + c] * (accel[k, c] - bias[3 + c])
                a += 0.5 * (before + after)
            if r == 2:
                a -= gravity_mps2
            o[12 + r] = s[12 + r] + a * dt
            o[9 + r] = s[9 + r] + s[12 + r] * dt + 0.5 * a * dt * dt


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def blend(stamps_ns, offset, limits, offsets):
    """Lets the offset (6,) rotation vector and translation fade: offsets (M, 6), row k at stamps_ns[k] (k >= 1).

    limits: (3,) time constant s, largest rate rad/s, largest rate m/s.
    """
    for c in range(6):
        offsets[0, c] = offset[c]
    for k in range(1, len(stamps_ns)):
        dt = (stamps_ns[k] - stamps_ns[k - 1]) * 1e-9
        for part in range(2):
            norm = 0.0
            for c in range(3 * part, 3 * part + 3):
                norm += offsets[k - 1, c] ** 2
            norm = math.sqrt(norm)
            step = min(norm * (1.0 - math.exp(-dt / limits[0])), limits[1 + part] * dt)
            scale = 1.0 - step / norm if norm > 1e-12 else 0.0
            for c in range(3 * part, 3 * part + 3):
                offsets[k, c] = scale * offsets[k - 1, c]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def emit(states, offsets, T_imu_lidar, poses):
    """poses (M, 12) row-major 3x4 of T_odom_lidar = T_odom_imu * offset * T_imu_lidar."""
    E = np.empty((3, 3))
    A = np.empty((3, 3))
    for k in range(len(states)):
        s = states[k]
        rotation(offsets[k, 0], offsets[k, 1], offsets[k, 2], E)
        for r in range(3):
            for c in range(3):
                A[r, c] = s[3 * r] * E[0, c] + s[3 * r + 1] * E[1, c] + s[3 * r + 2] * E[2, c]
        for r in range(3):
            for c in range(4):
                value = A[r, 0] * T_imu_lidar[0, c] + A[r, 1] * T_imu_lidar[1, c] + A[r, 2] * T_imu_lidar[2, c]
                if c == 3:
                    value += s[9 + r]
                    for j in range(3):
                        value += s[3 * r + j] * offsets[k, 3 + j]
                poses[k, 4 * r + c] = value


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def steps(states, poses, T_imu_lidar, worst):
    """Largest difference between an increment of `poses` and the IMU's own: worst (2,) m, rad is raised."""
    plain = np.empty((len(states), 12))
    emit(states, np.zeros((len(states), 6)), T_imu_lidar, plain)
    a = np.empty((3, 4))
    b = np.empty((3, 4))
    for k in range(1, len(states)):
        increment(poses[k - 1], poses[k], a)
        increment(plain[k - 1], plain[k], b)
        square = 0.0
        trace = 0.0
        for r in range(3):
            square += (a[r, 3] - b[r, 3]) ** 2
            for c in range(3):
                trace += a[r, c] * b[r, c]
        worst[0] = max(worst[0], math.sqrt(square))
        worst[1] = max(worst[1], math.acos(min(1.0, max(-1.0, 0.5 * (trace - 1.0)))))


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def increment(a, b, out):
    """out (3, 4) = inv(a) * b of two row-major 3x4 transforms (12,)."""
    for r in range(3):
        for c in range(4):
            value = 0.0
            for j in range(3):
                other = b[4 * j + c] - (a[4 * j + 3] if c == 3 else 0.0)
                value += a[4 * j + r] * other
            out[r, c] = value


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def quaternion(R, row, out):
    """out[row] (4,) = x y z w, w >= 0, of a rotation (3, 3 or 3, 4). Shepperd's method."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    i = 0
    if R[1, 1] > R[0, 0]:
        i = 1
    if R[2, 2] > R[i, i]:
        i = 2
    q = out[row]
    if trace >= R[i, i]:
        q[0], q[1], q[2] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
        q[3] = 1.0 + trace
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1.0 + R[i, i] - R[j, j] - R[k, k]
        q[j], q[k] = R[j, i] + R[i, j], R[k, i] + R[i, k]
        q[3] = R[k, j] - R[j, k]
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if q[3] < 0.0:
        norm = -norm
    for c in range(4):
        q[c] /= norm


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def split(poses, positions, quats):
    """Rows of 3x4 (M, 12) -> positions (M, 3), quats (M, 4) x y z w."""
    R = np.empty((3, 4))
    for k in range(len(poses)):
        for r in range(3):
            for c in range(4):
                R[r, c] = poses[k, 4 * r + c]
            positions[k, r] = R[r, 3]
        quaternion(R, k, quats)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def knots(poses, rotation, translation):
    """Poses (K, 12) of T_odom_lidar -> T_start_lidar as rotation vectors (K, 3) and translations (K, 3)."""
    D = np.empty((3, 4))
    q = np.empty((1, 4))
    for k in range(len(poses)):
        increment(poses[0], poses[k], D)
        quaternion(D, 0, q)
        v = math.sqrt(q[0, 0] ** 2 + q[0, 1] ** 2 + q[0, 2] ** 2)
        scale = 2.0 * math.atan2(v, q[0, 3]) / v if v > 1e-12 else 2.0
        for c in range(3):
            rotation[k, c] = scale * q[0, c]
            translation[k, c] = D[c, 3]
