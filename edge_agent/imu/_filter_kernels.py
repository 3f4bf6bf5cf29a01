"""Kernels of the Imu node's filter: its covariance over IMU samples, and one measurement after the other.

Rows of the error (N,), N >= 21, as filter.py has it: 0 rotation, 3 position, 6 velocity, 9 bias of gyro, 12 of accel.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from edge_agent.imu._kernels import integrate
from splitslam._motion_kernels import rotation_from_vector, vector_of
from splitslam._se3_kernels import adjoint, exp, inverse, multiply

FASTMATH = {"contract", "arcp", "nsz"}
LONGEST_STEP_NS = 10_000_000


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def transition(R, gained_mps, dt, M):
    """M (N, K) = F M of one step, with the errors of rotation, position and velocity in `odom`, from the left.

    R (3, 3): mean rotation in the step; gained_mps (3,): velocity that the specific force has brought. F is that of
    Sola, "Quaternion kinematics for the error-state Kalman filter", 2017, section 7.4 (global angular errors).
    """
    for c in range(M.shape[1]):
        turned, slowed = np.empty(3), np.empty(3)
        for r in range(3):
            turned[r] = dt * (R[r, 0] * M[9, c] + R[r, 1] * M[10, c] + R[r, 2] * M[11, c])
            slowed[r] = dt * (R[r, 0] * M[12, c] + R[r, 1] * M[13, c] + R[r, 2] * M[14, c])
        for r in range(3):
            i, j = (r + 1) % 3, (r + 2) % 3
            change = -slowed[r]
            change -= gained_mps[i] * (M[j, c] - 0.5 * turned[j]) - gained_mps[j] * (M[i, c] - 0.5 * turned[i])
            M[3 + r, c] += dt * (M[6 + r, c] + 0.5 * change)
            M[6 + r, c] += change
        for r in range(3):
            M[r, c] -= turned[r]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def carry(stamps_ns, states, gravity_mps2, noise, longest_ns, P, error):
    """Carries error (N, 1) and its covariance P (N, N) over states (M, 15), which were integrated at stamps_ns (M,).

    noise (3,): variances a second of rotation, position and velocity. In steps of up to longest_ns, or of one sample;
    half of a step's noise comes before it and half after, so that errors of rotation and velocity show in the position.
    """
    R, gained = np.empty((3, 3)), np.empty(3)
    i, last = 0, len(stamps_ns) - 1
    while i < last:
        j = i + 1
        while j < last and stamps_ns[j + 1] - stamps_ns[i] <= longest_ns:
            j += 1
        dt = (stamps_ns[j] - stamps_ns[i]) * 1e-9
        for r in range(3):
            gained[r] = states[j, 12 + r] - states[i, 12 + r]
            for c in range(3):
                R[r, c] = 0.5 * (states[i, 3 * r + c] + states[j, 3 * r + c])
        gained[2] += gravity_mps2 * dt
        for half in range(2):
            for k in range(9):
                P[k, k] += 0.5 * dt * noise[k // 3]
            if half == 0:
                transition(R, gained, dt, P)
                transition(R, gained, dt, P.T)
                transition(R, gained, dt, error)
        i = j


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def disturb(P, T_server_imu, variances):
    """Adds to P (N, N) what wanders by itself: bias of gyro, bias of accel, scale; and the server's odometry frame.

    variances (5,): of these three, if there is a scale, and of the frame's rotation and translation about the robot,
    which is at T_server_imu (4, 4) in it.
    """
    for k in range(6):
        P[9 + k, 9 + k] += variances[k // 3]
    if variances[2] > 0.0:
        P[21, 21] += variances[2]
    carry = np.empty((6, 6))
    adjoint(T_server_imu, carry)
    for r in range(6):
        for c in range(6):
            for k in range(6):
                P[15 + r, 15 + c] += carry[r, k] * variances[3 + k // 3] * carry[c, k]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def predict(window, T_server_imu, gravity_mps2, variances, poses, rest, P, error):
    """Brings poses (2, 4, 4), rest (10,), error (N,) and its covariance P (N, N) from a window's start to its end.

    window: (stamps_ns (M,), gyro (M, 3), accel (M, 3)). variances (8,), a second: of rotation, position and velocity,
    see `carry`; of what wanders, see `disturb`. T_server_imu (4, 4): at the window's end.
    """
    stamps_ns, gyro, accel = window
    states, last = np.empty((len(stamps_ns), 15)), len(stamps_ns) - 1
    for r in range(3):
        for c in range(3):
            states[0, 3 * r + c] = poses[0, r, c]
        states[0, 9 + r], states[0, 12 + r] = poses[0, r, 3], rest[r]
    integrate(stamps_ns, gyro, accel, rest[3:9], gravity_mps2, states)
    carry(stamps_ns, states, gravity_mps2, variances[:3], LONGEST_STEP_NS, P, error.reshape(-1, 1))
    disturb(P, T_server_imu, variances[3:] * ((stamps_ns[last] - stamps_ns[0]) * 1e-9))
    w = np.empty(3)
    vector_of(states[last, :9].reshape(3, 3), w)
    rotation_from_vector(w[0], w[1], w[2], poses[0])  # again orthonormal
    for r in range(3):
        poses[0, r, 3], rest[r] = states[last, 9 + r], states[last, 12 + r]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def measure(H, r, variance, P, change):
    """Takes rows of a measurement, one after the other: r (K,) = -H change (K, N), each with the same variance.

    change (N,): what is known of the error so far, P (N, N) its covariance. Both are brought up to date.
    """
    n = len(change)
    gain, covariance = np.empty(n), np.empty(n)
    for k in range(len(r)):
        spread, missing = variance, -r[k]
        for i in range(n):
            covariance[i] = 0.0
            for j in range(n):
                covariance[i] += P[i, j] * H[k, j]
            missing -= H[k, i] * change[i]
            spread += H[k, i] * covariance[i]
        for i in range(n):
            gain[i] = covariance[i] / spread
            change[i] += gain[i] * missing
        for i in range(n):
            for j in range(n):
                P[i, j] -= gain[i] * covariance[j]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def move(poses, rest, change, moved_poses, moved_rest):
    """A state with an error of change (N,) taken out.

    poses (2, 4, 4): T_odom_imu, T_odom_server. rest (10,): velocity, bias, scale of the wheels.
    """
    R, step = np.empty((3, 3)), np.empty((4, 4))
    rotation_from_vector(change[0], change[1], change[2], R)
    for r in range(3):
        for c in range(3):
            moved_poses[0, r, c] = R[r, 0] * poses[0, 0, c] + R[r, 1] * poses[0, 1, c] + R[r, 2] * poses[0, 2, c]
        moved_poses[0, r, 3] = poses[0, r, 3] + change[3 + r]
    moved_poses[0, 3] = poses[0, 3]
    for k in range(9):
        moved_rest[k] = rest[k] + change[6 + k]
    moved_rest[9] = rest[9] + (change[21] if len(change) > 21 else 0.0)
    exp(change[15:21], step)
    multiply(poses[1], step, moved_poses[1])


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def pose_residual(poses, T_server_imu, whiten, r, H):
    """r (6,), H (6, N): what is left of inv(T_server_imu) inv(T_odom_server) T_odom_imu, and how it goes with errors.

    Rotation vector and translation, whitened by whiten (6, 6). poses (2, 4, 4): see `move`.
    """
    back, T_imu_server, left = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    carry, raw, D = np.empty((6, 6)), np.empty(6), np.zeros((6, 12))
    inverse(poses[0], back)
    multiply(back, poses[1], T_imu_server)
    multiply(T_imu_server, T_server_imu, back)
    inverse(back, left)
    vector_of(left, raw)
    adjoint(T_imu_server, carry)
    for i in range(3):
        raw[3 + i] = left[i, 3]
        for j in range(3):
            D[i, j] = poses[0, j, i]  # errors of rotation and position in `odom` -> right tangent of T_odom_imu
            D[i, 6 + j] = -carry[i, j]
            turned = 0.0
            for k in range(3):
                D[3 + i, 3 + j] += left[i, k] * poses[0, j, k]
                D[3 + i, 6 + j] -= left[i, k] * carry[3 + k, j]
                turned -= left[i, k] * carry[3 + k, 3 + j]
            D[3 + i, 9 + j] = turned
    H[:] = 0.0
    for i in range(6):
        r[i] = 0.0
        for k in range(6):
            r[i] += whiten[i, k] * raw[k]
            for j in range(6):
                H[i, j] += whiten[i, k] * D[k, j]
                H[i, 15 + j] += whiten[i, k] * D[k, 6 + j]
