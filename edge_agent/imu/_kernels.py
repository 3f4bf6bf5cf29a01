"""IMU kernels: strap-down integration and the emission of continuous poses.

State row layout (M, 15): R_odom_imu row-major (9), position (3), velocity (3).
Integration by the trapezoidal rule on SO(3), Forster et al., "On-Manifold Preintegration", 2017, equations 29-31,
with the mean of neighbouring samples, so that a 10 Hz IMU is as usable as a 500 Hz one.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam._motion_kernels import vector_of

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
def window(own_ns, values, first, marks_ns, stamps_ns, gyro, accel):
    """Samples at marks_ns, rising, and at own stamps between the first and the last of them; returns how many.

    own_ns (N,), values (N, 6), gyro first; first: index of the first own sample after marks_ns[0]. Fills stamps_ns
    (M,), gyro, accel (M, 3). At marks between two own samples they are interpolated, beyond the own ones held.
    """
    count, mark, last = 0, 0, len(marks_ns) - 1
    t, after = marks_ns[0], first
    if after > 0 and own_ns[after - 1] == t:
        after -= 1
    while True:
        while after < len(own_ns) and own_ns[after] < t:
            after += 1
        i = min(after, len(own_ns) - 1)
        j, share = max(after - 1, 0), 0.0  # of the sample before
        if own_ns[i] > t and i > j:
            share = (own_ns[i] - t) / (own_ns[i] - own_ns[j])
        stamps_ns[count] = t
        for c in range(3):
            gyro[count, c] = (1.0 - share) * values[i, c] + share * values[j, c]
            accel[count, c] = (1.0 - share) * values[i, 3 + c] + share * values[j, 3 + c]
        count += 1
        while mark <= last and marks_ns[mark] <= t:
            mark += 1
        if mark > last:
            return count
        while after < len(own_ns) and own_ns[after] <= t:
            after += 1
        t = marks_ns[mark] if after == len(own_ns) else min(own_ns[after], marks_ns[mark])


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def roughness(values, count, out):
    """out (6,) = mean square by which the mean of `count` samples differs from the mean of its two neighbours.

    values (N, 6), N at least 3 * count; the newest whole blocks of it.
    """
    blocks = len(values) // count
    row = len(values) - blocks * count
    means = np.zeros((3, 6))
    out[:] = 0.0
    for block in range(blocks):
        newest = means[block % 3]
        newest[:] = 0.0
        for _ in range(count):
            for c in range(6):
                newest[c] += values[row, c] / count
            row += 1
        if block >= 2:
            before, middle = means[(block - 2) % 3], means[(block - 1) % 3]
            for c in range(6):
                rough = middle[c] - 0.5 * (before[c] + newest[c])
                out[c] += rough * rough / (blocks - 2)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def quietest(values, period_s, longest_s, densities):
    """densities (2,) = white noise of gyro and accel by the block length that says least: ImuBuffer.noise_densities.

    values (N, 6), N >= 12, gyro first, one each period_s. Blocks of 1, 2, 4, ... samples up to longest_s.
    """
    rough = np.empty(6)
    densities[:] = math.inf
    count = 1
    while count == 1 or (count * period_s <= longest_s and len(values) >= 12 * count):
        roughness(values, count, rough)
        for sensor in range(2):
            mean = (rough[3 * sensor] + rough[3 * sensor + 1] + rough[3 * sensor + 2]) / 3.0
            densities[sensor] = min(densities[sensor], math.sqrt(mean / 1.5 * period_s * count))
        count *= 2


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def place(states, out):
    """out (M, 12) row-major 3x4 of the poses in states (M, 15)."""
    for k in range(len(states)):
        for r in range(3):
            for c in range(3):
                out[k, 4 * r + c] = states[k, 3 * r + c]
            out[k, 4 * r + 3] = states[k, 9 + r]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def follow(stamps_ns, wanted, limits, lever_m, output, worst):
    """Output poses that move as the IMU says and close in on `wanted`, which corrections may have moved away.

    wanted, output: (M, 12) row-major 3x4 of T_odom_imu; output[0] is given, at the time of wanted[0]. Each step is
    wanted's own increment, then a part of the remaining error: limits (5,) are its time constant s, largest rate rad/s
    and m/s, largest step rad and m. lever_m (3,): the LiDAR in `imu`. worst (2,): the largest of these steps at the
    LiDAR, m and rad, is raised.
    """
    D = np.empty((3, 4))
    E = np.empty((3, 4))
    F = np.empty((3, 3))
    q = np.empty((1, 4))
    moved = np.empty(12)
    for k in range(1, len(stamps_ns)):
        dt = (stamps_ns[k] - stamps_ns[k - 1]) * 1e-9
        share = 1.0 - math.exp(-dt / limits[0])
        increment(wanted[k - 1], wanted[k], D)
        chain(output[k - 1], D, moved)
        increment(moved, wanted[k], E)
        quaternion(E, 0, q)
        v = math.sqrt(q[0, 0] ** 2 + q[0, 1] ** 2 + q[0, 2] ** 2)
        angle = 2.0 * math.atan2(v, q[0, 3])
        turn = min(angle * share, limits[1] * dt, limits[3])
        scale = turn / v if v > 1e-12 else 0.0
        rotation(scale * q[0, 0], scale * q[0, 1], scale * q[0, 2], F)
        distance = math.sqrt(E[0, 3] ** 2 + E[1, 3] ** 2 + E[2, 3] ** 2)
        move = min(distance * share, limits[2] * dt, limits[4])
        scale = move / distance if distance > 1e-12 else 0.0
        square = 0.0
        for r in range(3):
            D[r, 3] = scale * E[r, 3]
            at_lidar = D[r, 3] - lever_m[r]
            for c in range(3):
                D[r, c] = F[r, c]
                at_lidar += F[r, c] * lever_m[c]
            square += at_lidar * at_lidar
        chain(moved, D, output[k])
        worst[0] = max(worst[0], math.sqrt(square))
        worst[1] = max(worst[1], turn)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def chain(a, D, out):
    """out (12,) = a (12,) * D (3, 4)."""
    for r in range(3):
        for c in range(4):
            value = a[4 * r + 3] if c == 3 else 0.0
            for j in range(3):
                value += a[4 * r + j] * D[j, c]
            out[4 * r + c] = value


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def emit(imu_poses, T_imu_lidar, poses):
    """poses (M, 12) row-major 3x4 of T_odom_lidar = T_odom_imu * T_imu_lidar."""
    for k in range(len(imu_poses)):
        chain(imu_poses[k], T_imu_lidar, poses[k])


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


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def lead(stamps_ns, states, limits, T_imu_lidar, here, worst, poses):
    """poses (M, 12) row-major 3x4 of T_odom_lidar that follow states (M, 15), see `follow`.

    here (12,): T_odom_imu as it was given out for the first state; becomes that of the last. T_imu_lidar (4, 4).
    """
    wanted, output, lever_m = np.empty((len(states), 12)), np.empty((len(states), 12)), np.empty(3)
    lever_m[0], lever_m[1], lever_m[2] = T_imu_lidar[0, 3], T_imu_lidar[1, 3], T_imu_lidar[2, 3]
    place(states, wanted)
    output[0] = here
    follow(stamps_ns, wanted, limits, lever_m, output, worst)
    emit(output, T_imu_lidar, poses)
    here[:] = output[len(states) - 1]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def scan_motion(states, previous, here, T_imu_lidar, T_prev_lidar, poses):
    """poses (M - here, 12) row-major 3x4 of T_odom_lidar of states (M, 15) from row `here` on.

    T_prev_lidar (4, 4), of which the last row stays: from row `previous` to row `here`.
    """
    imu, before, D = np.empty((len(states) - here, 12)), np.empty((2, 1, 12)), np.empty((3, 4))
    place(states[here:], imu)
    emit(imu, T_imu_lidar, poses)
    place(states[previous : previous + 1], before[0])
    emit(before[0], T_imu_lidar, before[1])
    increment(before[1, 0], poses[0], D)
    for r in range(3):
        for c in range(4):
            T_prev_lidar[r, c] = D[r, c]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def pose_at(stamps_ns, poses, stamp_ns, T):
    """T (4, 4), of which the last row stays: poses (M, 12) at stamps_ns (M,), rising, interpolated, held beyond them.

    Rotation by slerp, translation linear.
    """
    after = min(np.searchsorted(stamps_ns, stamp_ns), len(stamps_ns) - 1)
    for r in range(3):
        for c in range(4):
            T[r, c] = poses[after, 4 * r + c]
    if after == 0 or stamps_ns[after] <= stamp_ns:
        return
    a, b = poses[after - 1], poses[after]
    share = (stamp_ns - stamps_ns[after - 1]) / (stamps_ns[after] - stamps_ns[after - 1])
    D, R, w = np.empty((3, 4)), np.empty((3, 3)), np.empty(3)
    increment(a, b, D)
    vector_of(D, w)
    rotation(share * w[0], share * w[1], share * w[2], R)
    for r in range(3):
        for c in range(3):
            T[r, c] = a[4 * r] * R[0, c] + a[4 * r + 1] * R[1, c] + a[4 * r + 2] * R[2, c]
        T[r, 3] = (1.0 - share) * a[4 * r + 3] + share * b[4 * r + 3]
